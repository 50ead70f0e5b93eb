"""Compiling the map's kernels before a run, so that no step of the run pays for it."""

import numpy as np

from robrain.protocol.model.frontier import find_frontiers
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.inflation import clearance_m
from robrain.protocol.model.occupancy_grid import GridGeometry, OccupancyGrid
from robrain.protocol.model.path_planning import (
    descend,
    distance_field,
    nearest_traversable,
    plan_path,
    shorten_path,
)
from robrain.protocol.model.ray_cast import cast_rays


def warm_up() -> None:
    """Call every kernel once with arrays of the types it meets in use.

    The first call on a computer compiles and stores the machine code beside the sources (some seconds); later
    processes load it (tenths of a second). Calling it again costs next to nothing.
    """
    geometry = GridGeometry(0.1, 0.0, 0.0, 8, 8)
    grid = OccupancyGrid(geometry)
    sensor = Pose2D(0.35, 0.35, 0.0)
    angles_rad = np.array([0.0, 1.0])
    circles = np.array([[0.6, 0.6, 0.05]])
    walls = np.zeros(geometry.shape, np.bool_)
    walls[:, 7] = True

    ranges_m = cast_rays(walls, geometry, sensor, angles_rad, 1.0, circles)
    grid.integrate_scan(sensor, angles_rad, ranges_m, 1.0, 0, circles)
    patch = grid.take_patch()
    if patch is not None:
        OccupancyGrid(geometry).merge_patch(patch.row, patch.column, patch.cells, patch.stamp_ms)
    find_frontiers(grid.classes(), ~walls)

    traversable = clearance_m(walls, geometry.resolution_m, 0.5) > 0
    cost = np.ones(geometry.shape, np.float32)
    start = nearest_traversable(traversable, (0, 7), 2) or (0, 0)
    path = plan_path(traversable, cost, start, (3, 0))
    if path is not None:
        shorten_path(path, traversable)
    descend(distance_field(traversable, cost, np.array([[3, 0]])), traversable, start)
