"""Path costs from robots and frontiers to all frontiers. Imports no kernels: a coordinator loads them once it is up."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.exploration.situation import FrontierCandidate, PathCosts
from robrain.protocol.clock import to_ns
from robrain.protocol.model.geometry import Point2D

if TYPE_CHECKING:
    from robrain.algorithms.navigation.navigation_grid import NavigationGrid, PathField

SNAP_M = 0.8
"""Greatest distance of a path's ends from the robot and from the frontier."""
FIELD_KEPT_NS = to_ns(5.0)
"""Costs between frontiers are computed again after this long (chosen: little changes far from the robots)."""


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
        candidates: Sequence[FrontierCandidate],
        shut: Sequence[tuple[float, float, float]] = (),
    ) -> None:
        self._navigation = navigation
        self._shut = shut
        cells = [navigation.snap(candidate.place, SNAP_M) for candidate in candidates]
        self._columns = [column for column, cell in enumerate(cells) if cell is not None]
        self._cells = [cell for cell in cells if cell is not None]
        self.count = len(cells)
        """Number of frontiers."""
        self._known: dict[Point2D, NDArray[np.float64]] = {}

    def costs_m(self, place: Point2D) -> NDArray[np.float64]:
        """Path cost from a place to each frontier, (frontiers,), metres of open floor; inf where there is no path."""
        paths_m = self._known.get(place)
        if paths_m is None:
            paths_m = np.full(self.count, np.inf)
            paths_m[self._columns] = self._navigation.ways_m(place, self._cells, snap_m=SNAP_M, shut=self._shut)
            self._known[place] = paths_m
        return paths_m

    def costs_along(self, field: "PathField") -> NDArray[np.float64]:
        """Path costs to each frontier from where a field was computed, (frontiers,)."""
        paths_m = np.full(self.count, np.inf)
        paths_m[self._columns] = field.to(self._cells)
        return paths_m


class FrontierFields:
    """Path costs from frontiers to everywhere, each kept for some seconds while the frontier is there.

    Otherwise the costs between frontiers would be most of the time of a decision. A new frontier has a new field. A
    path between older frontiers that has closed counts as open until their fields are due.
    """

    def __init__(self) -> None:
        self._fields: dict[Point2D, tuple[int, PathField | None]] = {}
        self._navigation: NavigationGrid | None = None

    def costs_between(self, paths: FrontierPaths, navigation: "NavigationGrid", now_ns: int) -> PathCosts:
        """A function that gives the path costs from a frontier to all frontiers, (frontiers,)."""
        known = {} if navigation is not self._navigation else self._fields
        self._navigation = navigation
        self._fields = {place: one for place, one in known.items() if now_ns - one[0] <= FIELD_KEPT_NS}
        used = self._fields

        def costs_m(place: Point2D) -> NDArray[np.float64]:
            if place not in used:
                used[place] = now_ns, navigation.cost_field(place, snap_m=SNAP_M)
            field = used[place][1]
            return paths.costs_along(field) if field is not None else np.full(paths.count, np.inf)

        return costs_m
