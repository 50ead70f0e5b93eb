"""The robot's own map: its recent surroundings, cut into submaps as it goes, and where those lie."""

import math
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.elementary_functions import arctan2
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.mapping.local_map import NO_DRIFT, Drift, LocalMap
from robrain.protocol.model.mapping.submap import IDENTITY, PARTS, SURFACE, SURFACES_MAX, VIEW_PARTS
from robrain.protocol.model.mapping.submap_graph import SubmapGraph
from robrain.protocol.model.occupancy_grid import GridGeometry, OccupancyGrid, PatchCells

Floats = NDArray[np.float64]
GRID_REACH_M = 20.0
LEAST = 1e-6
"""Variance of a submap against the one before, at least."""
TURN_M_PER_RAD = 0.3
"""A turn shows as much of new as this way."""


class SubmapSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """When a submap ends; chosen."""

    way_m: float = 5.0
    """After this way of the robot, turns counted in."""
    margin_m: float = 3.0
    """The robot's own map reaches so far beyond the team's grid: until it is corrected it may be shifted."""


class OwnPatch(NamedTuple):
    """What changed of one own submap; row and column on the lattice of the team's grid."""

    submap: int
    cells: PatchCells


class OwnSubmaps:
    """Maps what the robot itself sees, in the frame `local`.

    Args:
        geometry: the team's grid.
        graph: where the submaps lie.
        spec: when a submap ends.

    """

    def __init__(self, geometry: GridGeometry, graph: SubmapGraph, spec: SubmapSpec) -> None:
        self.graph = graph
        self.trajectory = -1
        self.T_arena_local = IDENTITY
        """Of the submap that is being made."""
        self._spec = spec
        margin = math.ceil(spec.margin_m / geometry.resolution_m)
        self._margin = margin
        self.grid = OccupancyGrid(
            GridGeometry(
                geometry.resolution_m,
                geometry.origin_x_m - margin * geometry.resolution_m,
                geometry.origin_y_m - margin * geometry.resolution_m,
                geometry.width + 2 * margin,
                geometry.height + 2 * margin,
            ),
            surfaces=True,
        )
        self._number: int | None = None
        self._oldest = 0
        self._drift = NO_DRIFT
        self._way_m = 0.0
        self._last: Pose2D | None = None

    @property
    def number(self) -> int | None:
        """Of the submap that is being made; None before the first scan."""
        return self._number

    def begin_trajectory(self, trajectory: int) -> None:
        """The robot was lost, and may be anywhere now: what it saw before is no map to go by."""
        self.trajectory = trajectory
        self.grid.forget()
        self.grid.begin_stretch()
        self._number, self._last, self._way_m = None, None, 0.0

    def is_over(self) -> bool:
        """Whether the submap is large enough: tell what is left of it, and begin another."""
        return self._number is None or self._way_m >= self._spec.way_m

    def begin_submap(self, number: int, T_local_robot: Pose2D, drift: Drift, covariance: Floats) -> None:
        """Begin a submap here.

        Args:
            number: greater than those before.
            T_local_robot: where the robot is on its map.
            drift: `LocalPose.drift`.
            covariance: (3, 3) of the robot's pose in the arena, for the first submap of a trajectory.

        """
        self._oldest = number if self._number is None else self._number
        if self._number is not None:
            self.grid.begin_stretch()
            number = max(number, self._number + 1)
            m2, rad2 = (max(now - then, LEAST) for now, then in zip(drift, self._drift, strict=True))
            covariance = np.diag((m2, m2, rad2))
        self.graph.begin(number, T_local_robot, self.T_arena_local, self.trajectory, covariance)
        self._number, self._way_m, self._drift = number, 0.0, drift

    def integrate(
        self,
        sensor: Pose2D,
        angles_rad: Floats,
        ranges_m: Floats,
        range_max_m: float,
        stamp_ms: int,
        ignore: Floats,
        drift: Drift,
    ) -> None:
        """Take in a scan; arguments are those of `OccupancyGrid.integrate_scan`, in the frame `local`."""
        if self._last is not None:
            turned_rad = math.remainder(sensor.yaw_rad - self._last.yaw_rad, math.tau)
            self._way_m += sensor.distance_m(self._last) + TURN_M_PER_RAD * abs(turned_rad)
        self._last = sensor
        self.grid.integrate_scan(sensor, angles_rad, ranges_m, range_max_m, stamp_ms, ignore, drift)

    def contradict(self, team: OccupancyGrid) -> None:
        """Tell again what the robot sees as floor and the team's map has as a wall, a mate that stood there perhaps.

        Only while the submap lies where it was drawn, or nearly so: the cells would not be the same.
        """
        T_arena_local, resolution_m = self.T_arena_local, team.geometry.resolution_m
        reach_m = max(abs(T_arena_local.x_m), abs(T_arena_local.y_m)) + GRID_REACH_M * abs(T_arena_local.yaw_rad)
        if reach_m < 0.5 * resolution_m:
            self.grid.contradict(team.log_odds, self._margin, self._margin)

    def take_patch(self) -> OwnPatch | None:
        """What changed of the current submap since the last call."""
        if self._number is None:
            return None
        patch = self.grid.take_patch()
        if patch is None:
            return None
        return OwnPatch(
            self._number, PatchCells(patch.row - self._margin, patch.column - self._margin, patch.cells, patch.stamp_ms)
        )

    def surfaces(self) -> NDArray[np.void]:
        """Where in their cells the walls of the current submap are, (n,) of `SURFACE`."""
        grid = self.grid
        rows, columns = grid.recent_surfaces()[:SURFACES_MAX].T
        surfaces = np.zeros(len(rows), SURFACE)
        surfaces["row"], surfaces["column"] = rows - self._margin, columns - self._margin
        right = grid.surface_at[rows, columns, 0] - (columns + 0.5)
        up = grid.surface_at[rows, columns, 1] - (rows + 0.5)
        surfaces["right"], surfaces["up"] = (
            np.clip(np.rint(right * PARTS), -127, 127),
            np.clip(np.rint(up * PARTS), -127, 127),
        )
        view_rad = arctan2(*grid.surface_view[rows, columns].T[::-1].astype(np.float64))
        surfaces["view"] = np.rint(view_rad * (VIEW_PARTS / math.tau)).astype(np.int64) % VIEW_PARTS
        return surfaces

    def local_map(self) -> LocalMap | None:
        """What localisation goes by; None before the first scan."""
        current = self.graph.current
        if current is None or self._number is None:
            return None
        x, y, yaw = np.diag(current.covariance).tolist()
        return LocalMap(
            self.grid,
            self.T_arena_local,
            current.anchor,
            (x, y, yaw),
            self._drift,
            self._number,
            self._oldest,
            self.trajectory,
        )
