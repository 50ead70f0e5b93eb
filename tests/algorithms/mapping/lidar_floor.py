"""Floors of 12 × 8 m, what a lidar sees on them, and what is mapped of that."""

import math

import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.localization.scan_match import beam_ends
from robrain.algorithms.mapping.local_map import NO_DRIFT, NONE, Drift, LocalMap, Variances
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.mapping.ray_cast import cast_rays
from robrain.algorithms.slam.submap import Submap
from robrain.algorithms.slam.submap_graph import GraphSpec, SubmapGraph
from robrain.plugins.skill.mapper.own_submaps import OwnSubmaps, SubmapSpec
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry

Floats = NDArray[np.float64]
GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 120, 80)
ANGLES_RAD = np.linspace(-math.pi, math.pi, 240, endpoint=False)
RANGE_M = 6.0
NOBODY = np.empty((0, 3))


class LidarFloor:
    """A floor with walls on a fine lattice, so that they lie anywhere in the cells of a map.

    Args:
        boxes: solid ones, x0, y0, x1, y1 in metres.

    """

    FINE = GridGeometry(0.02, 0.0, 0.0, 600, 400)

    def __init__(self, *boxes: tuple[float, float, float, float]) -> None:
        self.solid = np.zeros(self.FINE.shape, np.bool_)
        for box in boxes:
            x0, y0, x1, y1 = (round(edge_m / self.FINE.resolution_m) for edge_m in box)
            self.solid[y0:y1, x0:x1] = True

    def ranges_m(self, sensor: Pose2D, mates: Floats = NOBODY, range_max_m: float = RANGE_M) -> Floats:
        """What a lidar measures there; `mates` are (K, 3) circles x, y, radius."""
        return cast_rays(self.solid, self.FINE, sensor, ANGLES_RAD, range_max_m, mates)

    def points(self, sensor: Pose2D) -> Floats:
        """Where its beams end, in the sensor's frame."""
        return beam_ends(ANGLES_RAD, self.ranges_m(sensor), RANGE_M)

    def mapped(self, *sensors: Pose2D, drift: Drift = NO_DRIFT) -> OccupancyGrid:
        """A robot's own map, with surfaces, of scans from these places."""
        grid = OccupancyGrid(GEOMETRY, surfaces=True)
        for stamp_ms, sensor in enumerate(sensors, 1):
            ranges_m = self.ranges_m(sensor)
            grid.integrate_scan(sensor, ANGLES_RAD, ranges_m, RANGE_M, stamp_ms, NOBODY, drift)
        return grid

    def submap(self, *sensors: Pose2D, T_arena_local: Pose2D = IDENTITY) -> Submap:
        """What a robot tells of the same, once it is finished."""
        own = OwnSubmaps(GEOMETRY, SubmapGraph("r1", GraphSpec()), SubmapSpec())
        own.begin_submap(1, sensors[0], NO_DRIFT, np.eye(3))
        for stamp_ms, sensor in enumerate(sensors, 1):
            own.integrate(sensor, ANGLES_RAD, self.ranges_m(sensor), RANGE_M, stamp_ms, NOBODY, NO_DRIFT)
        patch = own.pop_patch()
        assert patch is not None
        submap = Submap(T_arena_local)
        submap.merge(patch.cells.row, patch.cells.column, patch.cells.cells, patch.cells.stamp_ms)
        submap.surfaces = own.surfaces()
        return submap


def local_map(
    grid: OccupancyGrid,
    T_arena_local: Pose2D = IDENTITY,
    *,
    anchor: Pose2D = IDENTITY,
    variances: Variances = NONE,
    drift: Drift = NO_DRIFT,
    trajectory: int = 0,
) -> LocalMap:
    """What localisation goes by."""
    return LocalMap(grid, T_arena_local, anchor, variances, drift, 1, 1, trajectory)


ROOM = LidarFloor(
    (0, 0, 8, 0.24), (0, 0, 0.24, 6), (7.76, 0, 8, 6), (0, 5.76, 8, 6), (3.06, 2.02, 3.72, 2.68), (5.5, 3.44, 6.42, 4.1)
)
ROOM_PLACES = [Pose2D(x, y, 0.3 * x) for x in (1.0, 2.1, 4.53, 7.0) for y in (1.0, 3.12, 5.0)]
CORRIDOR = LidarFloor((0, 2.74, 12, 3), (0, 5.02, 12, 5.26))
CORRIDOR_PLACES = [Pose2D(0.5 + 0.73 * n, 4.0, 0.0) for n in range(16)]
