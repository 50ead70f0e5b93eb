"""Walls of a map as points, and where they match those of another."""

import math

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.localization.scan_match import match_walls
from robrain.protocol.model.localization.scan_match_kernels import distance_window
from robrain.protocol.model.mapping.occupancy_grid import OccupancyGrid
from robrain.protocol.model.numeric.kernel_array import Floats
from robrain.protocol.model.numeric.small_linear_algebra import least_solution

APART_M, APART_RAD = 0.5, 0.2
"""Places that differ by less are one."""
NEAR_CELLS = 2.3
"""Walls that are this near to each other are the same wall."""


def wall_points(grid: OccupancyGrid) -> Floats:
    """(K, 2) the middles of the occupied cells, metres."""
    geometry = grid.geometry
    rows, columns = np.nonzero(grid.log_odds > 0)
    points = np.empty((len(rows), 2))
    points[:, 0] = geometry.origin_x_m + (columns + 0.5) * geometry.resolution_m
    points[:, 1] = geometry.origin_y_m + (rows + 0.5) * geometry.resolution_m
    return points


def distances_to_walls(grid: OccupancyGrid) -> NDArray[np.float32]:
    """float32 (H, W), cells to the nearest wall, as far as `NEAR_CELLS` needs it."""
    return distance_window(grid.log_odds, 0, 0, *grid.geometry.shape, math.ceil(NEAR_CELLS) + 1)


def some_points(points: Floats, count: int) -> Floats:
    """At most `count` of the points, spread over all of them."""
    return points[np.linspace(0, len(points) - 1, min(count, len(points))).astype(np.int64)]


def is_same_place(one: Pose2D, other: Pose2D) -> bool:
    """Whether two poses are one answer."""
    turn_rad = math.remainder(one.yaw_rad - other.yaw_rad, math.tau)
    return one.distance_m(other) < APART_M and abs(turn_rad) < APART_RAD


def matched_place(grid: OccupancyGrid, guess: Pose2D, points: Floats, reaches_m: tuple[float, ...]) -> Pose2D:
    """A pose near a guess at which points, (N, 2) metres in its frame, match the walls of a map."""
    for reach_m in reaches_m:
        held = match_walls(grid.log_odds, grid.geometry, guess, points, reach_m).directions
        if not held:
            return guess
        rows, offsets_m = np.array([each.row for each in held]), np.array([each.offset_m for each in held])
        x_m, y_m, yaw_rad = least_solution(rows, offsets_m).tolist()
        guess = Pose2D(guess.x_m + x_m, guess.y_m + y_m, math.remainder(guess.yaw_rad + yaw_rad, math.tau))
    return guess
