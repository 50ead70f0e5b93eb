import math

import numpy as np

from robrain.algorithms.localization.scan_match import beam_ends
from robrain.algorithms.localization.surface_match import agreement
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.mapping.ray_cast import cast_rays
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry

GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 120, 80)
ANGLES_RAD = np.linspace(-math.pi, math.pi, 180, endpoint=False)
RANGE_M = 6.0
NOBODY = np.empty((0, 3))


def floor(*boxes):
    solid = np.ones(GEOMETRY.shape, np.bool_)
    solid[2:-2, 2:-2] = False
    for x0, y0, x1, y1 in boxes:
        solid[round(y0 * 10) : round(y1 * 10), round(x0 * 10) : round(x1 * 10)] = True
    return solid


def seen(solid, pose):
    return beam_ends(ANGLES_RAD, cast_rays(solid, GEOMETRY, pose, ANGLES_RAD, RANGE_M, NOBODY), RANGE_M)


def mapped(solid):
    grid = OccupancyGrid(GEOMETRY)
    for stamp, (x, y) in enumerate((x, y) for x in range(1, 12) for y in range(1, 8)):
        if not solid[10 * y, 10 * x]:
            at = Pose2D(x + 0.05, y + 0.05, 0.0)
            ranges_m = cast_rays(solid, GEOMETRY, at, ANGLES_RAD, RANGE_M, NOBODY)
            grid.integrate_scan(at, ANGLES_RAD, ranges_m, RANGE_M, stamp, NOBODY)
    return grid.log_odds


FLOOR = floor((3, 2, 3.7, 2.6), (5.5, 4.4, 7.4, 5), (9, 0, 9.2, 3.1), (2, 6, 2.3, 8), (6.5, 2.2, 6.9, 3))
MAP = mapped(FLOOR)


def test_where_nothing_is_known_nothing_is_compared():
    assert agreement(np.zeros_like(MAP), GEOMETRY, Pose2D(2.0, 2.0, 0.0), seen(FLOOR, Pose2D(2.0, 2.0, 0.0))) == (0, 0)
    assert agreement(MAP, GEOMETRY, Pose2D(-70.0, 2.0, 0.0), np.ones((40, 2))) == (0, 0)
