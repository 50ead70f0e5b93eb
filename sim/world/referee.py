"""The referee: how much of the floor that robots can reach the team's maps know.

It hears the same patches that the robots send each other, so its map is what the team could know together.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.mapping.grid_geometry import GridGeometry
from robrain.protocol.model.slam.submap import Submap
from robrain.protocol.model.slam.submap_atlas import SubmapAtlas
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages.maps.map_patch import in_own_time, take_message
from robrain.protocol.wire.topics import ROBOT_MAP
from robrain.sim.maps.floor_plan import TEAM_RESOLUTION_M, FloorPlan

PATCHES_A_STEP = 4096
EDGE_CELLS = 3
"""Width of the margin around the floor plan, for walls at its edge that are measured just outside it."""


def team_geometry(plan: FloorPlan, resolution_m: float = TEAM_RESOLUTION_M) -> GridGeometry:
    """The grid that a team in this arena maps on: it covers the plan and a margin of `EDGE_CELLS`."""
    width_m, height_m = plan.size_m
    return GridGeometry(
        resolution_m,
        plan.origin_x_m - EDGE_CELLS * resolution_m,
        plan.origin_y_m - EDGE_CELLS * resolution_m,
        # The slack keeps a size that is a whole number of cells from being rounded up.
        math.ceil(width_m / resolution_m - 1e-6) + 2 * EDGE_CELLS,
        math.ceil(height_m / resolution_m - 1e-6) + 2 * EDGE_CELLS,
    )


class Referee:
    """Merges all robots' patches and tells the explored share.

    Args:
        plan: the true floor.
        starts: where the robots start, arena frame.
        clearance_m: least clearance of the robots, which decides what they can reach
            (`protocol/model/navigation/clearance.py`).
        geometry: the team's grid; patches for another are refused and counted in `refused_patches`.
        endpoint: where the patches are heard.

    """

    def __init__(
        self, plan: FloorPlan, starts: Sequence[Point2D], clearance_m: float, geometry: GridGeometry, endpoint: Endpoint
    ) -> None:
        self._atlas = SubmapAtlas(geometry)
        self.grid = self._atlas.grid
        """The team's map."""
        self._misfits = 0
        self._inbox = Inbox(PATCHES_A_STEP)
        self._weights = floor_weights(plan, starts, clearance_m, geometry)
        self._cell_m2 = plan.resolution_m**2
        self._total = int(self._weights.sum())
        self._fraction = 0.0
        self._version = self.grid.version
        self._clock = endpoint.clock
        endpoint.subscribe(self._inbox, ROBOT_MAP)

    @property
    def explored_fraction(self) -> float:
        """Share of the reachable floor's area whose team cell is known, 0 to 1, as of the last `step()`."""
        return self._fraction

    @property
    def refused_patches(self) -> int:
        """Patches that do not decode, are for another grid, or are not plausible."""
        return self._misfits + self._inbox.refused

    @property
    def submaps(self) -> Mapping[tuple[str, int], Submap]:
        """What each robot has told of the floor, by robot and number; read-only."""
        return self._atlas.submaps

    def unseen_m2(self) -> NDArray[np.float64]:
        """Area of reachable floor in each unknown cell of the team's grid: (H, W), square metres."""
        return np.where(self.grid.known(), 0.0, self._weights * self._cell_m2)

    def step(self) -> None:
        """Merge what has arrived."""
        for received in self._inbox.drain():
            try:
                take_message(self._atlas, in_own_time(received.message, self._clock.now_ns()))
            except ValueError:
                self._misfits += 1
        if self.grid.version != self._version and self._total:
            self._version = self.grid.version
            self._fraction = int(self._weights[self.grid.known()].sum()) / self._total


def floor_weights(
    plan: FloorPlan, starts: Sequence[Point2D], clearance_m: float, geometry: GridGeometry
) -> NDArray[np.int64]:
    """(H, W) of the team's grid: the number of the plan's cells in each that robots from `starts` can reach."""
    return _cells_per_team_cell(plan, plan.reachable(list(starts), clearance_m), geometry)


def _cells_per_team_cell(plan: FloorPlan, mask: NDArray[np.bool_], geometry: GridGeometry) -> NDArray[np.int64]:
    """(H, W) of the team's grid: how many of the plan's marked cells have their centre in each cell."""
    rows, columns = np.nonzero(mask)
    # Both grids start at the plan's origin; the slack keeps centres that lie on a border on one side of it.
    scale = plan.resolution_m / geometry.resolution_m
    team_rows = np.floor(
        (rows + 0.5) * scale + (plan.origin_y_m - geometry.origin_y_m) / geometry.resolution_m + 1e-9
    ).astype(np.int64)
    team_columns = np.floor(
        (columns + 0.5) * scale + (plan.origin_x_m - geometry.origin_x_m) / geometry.resolution_m + 1e-9
    ).astype(np.int64)
    within = (team_rows >= 0) & (team_rows < geometry.height) & (team_columns >= 0) & (team_columns < geometry.width)
    flat = team_rows[within] * geometry.width + team_columns[within]
    return np.bincount(flat, minlength=geometry.width * geometry.height).reshape(geometry.shape)
