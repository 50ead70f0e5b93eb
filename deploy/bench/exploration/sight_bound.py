"""How soon any number of robots that know the floor could have seen it: what no exploration can be faster than."""

import math

import numpy as np

from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.mapping.grid_geometry import GridGeometry
from robrain.protocol.model.mapping.ray_cast import cast_rays_of
from robrain.protocol.model.navigation.clearance import least_clearance_m
from robrain.protocol.model.navigation.path_planning import distance_field
from robrain.protocol.model.numeric.kernel_array import Floats
from robrain.sim.maps.floor_plan import FloorPlan

STANDPOINT_M = 0.4
"""Distance between the places from which is looked."""
RAYS = 720
"""At 6 m they are 5 cm apart, the pitch of the finest maps."""
PERCENTILE = 95.0
NOBODY = np.empty((0, 3))


def sight_bound_s(plan: FloorPlan, start: Point2D, radius_m: float, range_m: float, speed_m_s: float) -> float:
    """The least time in which robots from `start`, however many there are, can have seen 95 % of the floor, in seconds.

    A place is seen first from where the path is shortest among all places with it in sight and in range; the 95th
    percentile of these path lengths over the floor, at top speed. Half a diagonal between standpoints is taken off.

    Args:
        plan: the floor.
        start: where the team starts, arena frame.
        radius_m: of each robot.
        range_m: of the lidars.
        speed_m_s: top speed.

    """
    reachable = plan.reachable([start], least_clearance_m(radius_m))
    at = np.array([plan.cell_of(start.x_m, start.y_m)], dtype=np.int64)
    field = distance_field(reachable, np.ones(reachable.shape, np.float32), at)
    away_m: Floats = field.astype(np.float64) * plan.resolution_m
    step = max(1, round(STANDPOINT_M / plan.resolution_m))
    rows, columns = np.nonzero(np.isfinite(away_m[::step, ::step]) & reachable[::step, ::step])
    seen_m = _seen_m(plan, np.stack([rows * step, columns * step], axis=1), away_m, range_m)
    lengths_m = seen_m[reachable]
    farthest_m = float(np.percentile(lengths_m[np.isfinite(lengths_m)], PERCENTILE))
    return max(0.0, farthest_m - STANDPOINT_M / math.sqrt(2.0)) / speed_m_s


def _seen_m(plan: FloorPlan, cells: np.ndarray, away_m: Floats, range_m: float) -> Floats:
    """Length of the shortest path to one of the cells that sees a cell, (rows, columns), metres; inf if none does."""
    height, width = plan.occupied.shape
    geometry = GridGeometry(plan.resolution_m, plan.origin_x_m, plan.origin_y_m, width, height)
    walls = plan.occupied.copy()  # writable: a read-only array would be copied for every look
    angles_rad = np.linspace(-math.pi, math.pi, RAYS, endpoint=False)
    along_m = np.arange(0.0, range_m, 0.7 * plan.resolution_m)
    x_m = along_m * np.cos(angles_rad)[:, np.newaxis]
    y_m = along_m * np.sin(angles_rad)[:, np.newaxis]
    seen_m = np.full((height, width), np.inf)
    for row, column in cells.tolist():
        place = geometry.center_of(row, column)
        ranges_m = cast_rays_of(walls, geometry, Pose2D(place.x_m, place.y_m, 0.0), angles_rad, range_m, NOBODY)
        is_seen = along_m < np.minimum(ranges_m, range_m)[:, np.newaxis]
        rows = ((place.y_m + y_m[is_seen] - plan.origin_y_m) / plan.resolution_m).astype(np.int64)
        columns = ((place.x_m + x_m[is_seen] - plan.origin_x_m) / plan.resolution_m).astype(np.int64)
        is_inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        rows, columns = rows[is_inside], columns[is_inside]
        seen_m[rows, columns] = np.minimum(seen_m[rows, columns], away_m[row, column])
    return seen_m
