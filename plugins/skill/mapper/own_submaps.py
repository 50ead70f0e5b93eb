"""The robot's own map: its recent surroundings, divided into submaps."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.localization.scan_match import without_dropouts
from robrain.algorithms.mapping.local_map import NO_DRIFT, Drift, LocalMap
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid, PatchCells
from robrain.algorithms.numeric.elementary_functions import arctan2
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.algorithms.slam.submap import PARTS, SURFACE, SURFACES_MAX, VIEW_PARTS
from robrain.algorithms.slam.submap_graph import SubmapGraph
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.map_frame import ARENA
from robrain.protocol.model.ranges import PositiveInt

GRID_REACH_M = 20.0
"""Distance from the frame's origin, metres, at which its yaw must not shift cells."""
LEAST, LEAST_SHARE = 1e-6, 0.1
"""Least variance (m², rad²) of a submap's pose relative to the one before. It is at most that share of the pose's own
variance, since exact odometry is better."""
TURN_M_PER_RAD = 0.3
"""Metres of path that a turn by one radian counts as: it shows new surroundings too."""


class SubmapSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """When a submap ends, and how far the robot's own map extends."""

    path_m: float = 5.0
    """Length of the path on which one submap is made, metres; turns count too. Drift on it is less than a cell."""
    margin_m: float = 3.0
    """Metres by which the robot's own map extends beyond the team's grid, because it may be shifted."""
    misses_min: PositiveInt = 4
    """Number of neighbouring beams without a return that mean a free path; 1 for a lidar that misses no wall."""


class OwnPatch(NamedTuple):
    """Changes of one own submap; row and column are counted from the origin of the team's grid."""

    submap: int
    cells: PatchCells


class OwnSubmaps:
    """Maps this robot's observations, in the frame `local`.

    Args:
        geometry: the team's grid.
        graph: the robot's part of the pose graph.
        spec: parameters.

    """

    def __init__(self, geometry: GridGeometry, graph: SubmapGraph, spec: SubmapSpec) -> None:
        self.graph = graph
        self.trajectory = -1
        self.frame = ARENA
        """The map frame in which the submap that is being made lies."""
        self.reason = ""
        """Reason why this is not the arena frame."""
        self.T_arena_local = IDENTITY
        """Pose of the current submap's frame."""
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
        self.number: int | None = None
        """Number of the current submap; None before the first scan."""
        self._oldest = 0
        self._drift = NO_DRIFT
        self._path_m = 0.0
        self._last: Pose2D | None = None

    def begin_trajectory(self, trajectory: int) -> None:
        """Clear the map: the robot was lost and may be anywhere now."""
        self.trajectory = trajectory
        self.grid.forget()
        self.grid.begin_stretch()
        self.number, self._last = None, None

    def is_over(self) -> bool:
        """Whether the current submap is complete, or there is none, so that the next must begin."""
        return self.number is None or self._path_m >= self._spec.path_m

    def begin_submap(self, number: int, T_local_robot: Pose2D, drift: Drift, covariance: Floats) -> None:
        """Begin the next submap.

        Args:
            number: greater than those before.
            T_local_robot: pose of the robot on its own map.
            drift: `LocalPose.drift`.
            covariance: (3, 3) of the robot's pose in the arena.

        """
        self._oldest = number if self.number is None else self.number
        if self.number is not None:
            self.grid.begin_stretch()
            number = max(number, self.number + 1)
            xx, yy, yaw = covariance.diagonal().tolist()
            m2 = max(drift[0] - self._drift[0], min(LEAST, LEAST_SHARE * 0.5 * (xx + yy)))
            rad2 = max(drift[1] - self._drift[1], min(LEAST, LEAST_SHARE * yaw))
            covariance = np.diag((m2, m2, rad2))
        self.graph.begin(number, T_local_robot, self.T_arena_local, self.trajectory, covariance, self.frame)
        self.number, self._path_m, self._drift = number, 0.0, drift

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
        """Map a scan; arguments are those of `OccupancyGrid.integrate_scan`, in the frame `local`.

        Fewer than `SubmapSpec.misses_min` neighbouring beams without a return free nothing.
        """
        if self._last is not None:
            turned_rad = math.remainder(sensor.yaw_rad - self._last.yaw_rad, math.tau)
            self._path_m += sensor.distance_m(self._last) + TURN_M_PER_RAD * abs(turned_rad)
        self._last = sensor
        received_m = without_dropouts(ranges_m, range_max_m, self._spec.misses_min)
        self.grid.integrate_scan(sensor, angles_rad, received_m, range_max_m, stamp_ms, ignore, drift)

    def contradict(self, team: OccupancyGrid) -> None:
        """Mark floor that the team's map shows as a wall, such as a teammate that stood there, to publish it again.

        Does nothing while the submap is shifted by half a cell or more, because cells would not correspond.
        """
        T_arena_local, resolution_m = self.T_arena_local, team.geometry.resolution_m
        reach_m = max(abs(T_arena_local.x_m), abs(T_arena_local.y_m)) + GRID_REACH_M * abs(T_arena_local.yaw_rad)
        if reach_m < 0.5 * resolution_m:
            self.grid.contradict(team.log_odds, self._margin, self._margin)

    def pop_patch(self) -> OwnPatch | None:
        """Changes of the current submap since the last call; None if there are none."""
        if self.number is None:
            return None
        patch = self.grid.pop_patch()
        if patch is None:
            return None
        return OwnPatch(
            self.number, PatchCells(patch.row - self._margin, patch.column - self._margin, patch.cells, patch.stamp_ms)
        )

    def surfaces(self) -> NDArray[np.void]:
        """Surfaces (n,) of `SURFACE` of the current submap: the walls' places within their cells."""
        grid = self.grid
        rows, columns = grid.recent_surfaces()[:SURFACES_MAX].T
        surfaces = np.zeros(len(rows), SURFACE)
        surfaces["row"], surfaces["column"] = rows - self._margin, columns - self._margin
        right = grid.surfaces.at[rows, columns, 0] - (columns + 0.5)
        up = grid.surfaces.at[rows, columns, 1] - (rows + 0.5)
        surfaces["right"], surfaces["up"] = (
            np.clip(np.rint(right * PARTS), -127, 127),
            np.clip(np.rint(up * PARTS), -127, 127),
        )
        view_rad = arctan2(*grid.surfaces.seen_along[rows, columns].T[::-1].astype(np.float64))
        surfaces["view"] = np.rint(view_rad * (VIEW_PARTS / math.tau)).astype(np.int64) % VIEW_PARTS
        return surfaces

    def local_map(self) -> LocalMap | None:
        """The map for localisation; None before the first scan."""
        current = self.graph.current
        if current is None or self.number is None:
            return None
        x, _, x_yaw, _, y, y_yaw, _, _, yaw = current.covariance.ravel().tolist()
        return LocalMap(
            self.grid,
            self.T_arena_local,
            current.anchor,
            (x, y, yaw),
            self._drift,
            self.number,
            self._oldest,
            self.trajectory,
            self.frame,
            self.reason,
            (x_yaw, y_yaw),
        )
