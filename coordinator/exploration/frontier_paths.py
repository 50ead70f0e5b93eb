"""Path costs from any place to the frontiers."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robrain.coordinator.exploration.situation import Candidate
from robrain.protocol.model.geometry import Point2D

if TYPE_CHECKING:  # brings the map's kernels, which a coordinator loads when it is up (coordinator/live.py)
    from robrain.protocol.model.navigation.navigation_grid import NavigationGrid

SNAP_M = 0.8
"""Greatest distance of a path's ends from the robot and from the frontier."""


class FrontierPaths:
    """Path costs on one map, each place computed once.

    Args:
        navigation: the team's map.
        candidates: frontiers.
        shut: circles (x, y, radius in metres) whose narrow places are impassable.

    """

    def __init__(
        self,
        navigation: "NavigationGrid",
        candidates: Sequence[Candidate],
        shut: Sequence[tuple[float, float, float]] = (),
    ) -> None:
        self._navigation = navigation
        self._shut = shut
        cells = [navigation.snap(candidate.place, SNAP_M) for candidate in candidates]
        self._columns = [column for column, cell in enumerate(cells) if cell is not None]
        self._cells = [cell for cell in cells if cell is not None]
        self._count = len(cells)
        self._known: dict[Point2D, NDArray[np.float64]] = {}

    def costs_m(self, place: Point2D) -> NDArray[np.float64]:
        """Path cost from a place to each frontier, (frontiers,), metres of open floor; inf where there is no path."""
        ways_m = self._known.get(place)
        if ways_m is None:
            ways_m = np.full(self._count, np.inf)
            ways_m[self._columns] = self._navigation.ways_m(place, self._cells, snap_m=SNAP_M, shut=self._shut)
            self._known[place] = ways_m
        return ways_m
