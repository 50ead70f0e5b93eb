"""The robot's own map: its recent surroundings, cut into submaps as it goes, and where those lie."""

import math
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.mapping.local_map import LocalMap, Variances
from robrain.protocol.model.mapping.submap import IDENTITY
from robrain.protocol.model.mapping.submap_graph import SubmapGraph
from robrain.protocol.model.occupancy_grid import GridGeometry, OccupancyGrid, PatchCells

Floats = NDArray[np.float64]
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

    def begin_submap(self, number: int, T_local_robot: Pose2D, covariance: Floats) -> None:
        """Begin a submap here; arguments are those of `SubmapGraph.begin`."""
        if self._number is not None:
            self.grid.begin_stretch()
        number = number if self._number is None else max(number, self._number + 1)
        self.graph.begin(number, T_local_robot, self.T_arena_local, self.trajectory, covariance, self._way_m)
        self._number, self._way_m = number, 0.0

    def integrate(
        self,
        sensor: Pose2D,
        angles_rad: Floats,
        ranges_m: Floats,
        range_max_m: float,
        stamp_ms: int,
        ignore: Floats,
    ) -> None:
        """Take in a scan; arguments are those of `OccupancyGrid.integrate_scan`, in the frame `local`."""
        if self._last is not None:
            turned_rad = math.remainder(sensor.yaw_rad - self._last.yaw_rad, math.tau)
            self._way_m += sensor.distance_m(self._last) + TURN_M_PER_RAD * abs(turned_rad)
        self._last = sensor
        self.grid.integrate_scan(sensor, angles_rad, ranges_m, range_max_m, stamp_ms, ignore)

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

    def local_map(self) -> LocalMap:
        """What localisation goes by."""
        return LocalMap(self.grid, self.T_arena_local, self._variances(), self.trajectory)

    def _variances(self) -> Variances:
        current = self.graph.current
        if current is None or self._last is None:
            return 0.0, 0.0, 0.0
        drift_m2, drift_rad2 = self.graph.drift(self._way_m)
        covariance = current.covariance
        # The yaw at the anchor moves the robot, which is some metres on.
        away_m2 = current.anchor.distance_m(self._last) ** 2
        x_m2, y_m2, yaw_rad2 = float(covariance[0, 0]), float(covariance[1, 1]), float(covariance[2, 2])
        across_m2 = 0.5 * yaw_rad2 * away_m2
        return x_m2 + across_m2 + drift_m2, y_m2 + across_m2 + drift_m2, yaw_rad2 + drift_rad2
