"""Measurements of a range sensor in a known world: exact rays through a grid and past circles.

With `echo_rad`, `cast_rays` adds glass, through which lidars see, and mirrors.
"""

import math

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from robrain.algorithms.numeric.kernel_array import FLOAT64, Floats, kernel_array
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry

SLACK_M = 1e-3
"""A circle out of reach by less than this is still checked: rounding must not decide."""
SOLID = 1
"""An ordinary wall; 0 is free floor."""
GLASS_X, GLASS_Y = 2, 4
"""A pane whose normal lies along x, along y."""
MIRROR_WEST, MIRROR_EAST, MIRROR_SOUTH, MIRROR_NORTH = 8, 16, 32, 64
"""Side of the cell that is a mirror: lower x, higher x, lower y, higher y."""


def cast_rays(
    occupied: NDArray[np.bool_] | NDArray[np.uint8],
    geometry: GridGeometry,
    sensor: Pose2D,
    angles_rad: Floats,
    range_max_m: float,
    circles: Floats,
    echo_rad: float | None = None,
) -> Floats:
    """Distances (N,) in metres to the first obstacle of each ray; exactly `range_max_m` where there is none nearer.

    `occupied` (H, W) marks the obstacles; beyond the grid all is occupied, the arena's edge closes it. `sensor` is in
    the arena frame, `angles_rad` (N,) in the sensor's frame. `circles` (K, 3) are further obstacles x, y, radius in
    metres of the arena frame. A circle around the sensor is the body that carries it and is not seen. A sensor within
    an occupied cell measures 0. Rays end where they enter a cell, found by the traversal of Amanatides and Woo, *A Fast
    Voxel Traversal Algorithm for Ray Tracing*, Eurographics 1987.

    With `echo_rad`, `occupied` is the sum of the constants above for each cell: there may be glass and mirrors. A pane
    returns the beams that meet it within this angle of its normal. Other beams pass it straight on; behind a pane at
    the grid's edge they meet nothing. A mirror reflects a beam once. The beam's range is the length of the whole path,
    and it may end at the body that carries the sensor. A second mirror on the path is a wall.
    """
    return cast_rays_of(
        # One type for each argument, for any input: the kernel is compiled once for every combination.
        kernel_array(occupied, occupied.dtype),
        geometry,
        sensor,
        kernel_array(angles_rad, FLOAT64),
        range_max_m,
        kernel_array(circles, FLOAT64),
        None if echo_rad is None else math.cos(echo_rad),
    )


def cast_rays_of(
    occupied: NDArray[np.bool_] | NDArray[np.uint8],
    geometry: GridGeometry,
    sensor: Pose2D,
    angles_rad: Floats,
    range_max_m: float,
    circles: Floats,
    echo_cosine: float | None = None,
) -> Floats:
    """As `cast_rays`, for a sensor that asks many times: all arrays are `kernel_array`s.

    `echo_cosine` is the cosine of `echo_rad`.
    """
    ranges_m: Floats = _cast_rays(
        occupied.view(np.uint8),
        float(geometry.resolution_m),
        float(geometry.origin_x_m),
        float(geometry.origin_y_m),
        float(sensor.x_m),
        float(sensor.y_m),
        float(sensor.yaw_rad),
        angles_rad,
        float(range_max_m),
        circles,
        echo_cosine,
    )
    return ranges_m


@register_jitable
def _near_circles(circles: Floats, x_m: float, y_m: float, range_max_m: float) -> tuple[Floats, int]:
    """The circles that a ray can reach, in their order, and how many; by way of a mirror none is nearer."""
    near = np.empty_like(circles)
    count = 0
    for k in range(circles.shape[0]):
        dx_m, dy_m = circles[k, 0] - x_m, circles[k, 1] - y_m
        reach_m = range_max_m + circles[k, 2] + SLACK_M
        if dx_m * dx_m + dy_m * dy_m <= reach_m * reach_m:
            near[count] = circles[k]
            count += 1
    return near, count


@njit(cache=True, nogil=True)
def _cast_rays(
    surfaces: NDArray[np.uint8],
    resolution_m: float,
    origin_x_m: float,
    origin_y_m: float,
    sensor_x_m: float,
    sensor_y_m: float,
    yaw_rad: float,
    angles_rad: Floats,
    range_max_m: float,
    circles: Floats,
    echo_cosine: float | None,
) -> Floats:
    """Ranges of beams; without `echo_cosine` all surfaces are solid, and numba omits the code for others."""
    height, width = surfaces.shape
    start_x = (sensor_x_m - origin_x_m) / resolution_m
    start_y = (sensor_y_m - origin_y_m) / resolution_m
    start_row, start_column = math.floor(start_y), math.floor(start_x)
    ranges_m = np.empty(angles_rad.shape[0])
    within = 0 <= start_row < height and 0 <= start_column < width
    if not within or surfaces[start_row, start_column] != 0:
        ranges_m[:] = 0.0
        return ranges_m
    range_max = range_max_m / resolution_m
    near, count = _near_circles(circles, sensor_x_m, sensor_y_m, range_max_m)
    for ray in range(angles_rad.shape[0]):
        direction_x = math.cos(yaw_rad + angles_rad[ray])
        direction_y = math.sin(yaw_rad + angles_rad[ray])
        step_column = 1 if direction_x > 0 else -1
        step_row = 1 if direction_y > 0 else -1
        delta_x = 1.0 / abs(direction_x) if direction_x != 0 else np.inf
        delta_y = 1.0 / abs(direction_y) if direction_y != 0 else np.inf
        gap_x = start_column + 1 - start_x if direction_x > 0 else start_x - start_column
        gap_y = start_row + 1 - start_y if direction_y > 0 else start_y - start_row
        next_x = gap_x * delta_x if delta_x < np.inf else np.inf  # 1 / 5e-324 is infinite, too
        next_y = gap_y * delta_y if delta_y < np.inf else np.inf
        row, column = start_row, start_column
        distance = range_max
        turn = -1.0
        back_x, back_y = direction_x, direction_y
        is_in_glass = False
        while True:
            crosses_column = next_x < next_y
            if crosses_column:
                entry = next_x
                next_x += delta_x
                column += step_column
            else:
                entry = next_y
                next_y += delta_y
                row += step_row
            if entry >= range_max:
                break
            if echo_cosine is None:
                if not (0 <= row < height and 0 <= column < width) or surfaces[row, column] != 0:
                    distance = entry
                    break
                continue
            if not (0 <= row < height and 0 <= column < width):
                if not is_in_glass:
                    distance = entry
                break
            surface = surfaces[row, column]
            if surface == 0:
                is_in_glass = False
                continue
            if surface & (GLASS_X | GLASS_Y):
                along_normal = abs(direction_x) if surface & GLASS_X else 0.0
                if surface & GLASS_Y:
                    along_normal = max(along_normal, abs(direction_y))
                if along_normal < echo_cosine:
                    is_in_glass = True
                    continue
            elif turn < 0:
                side = MIRROR_SOUTH if step_row > 0 else MIRROR_NORTH
                if crosses_column:
                    side = MIRROR_WEST if step_column > 0 else MIRROR_EAST
                if surface & side:
                    # The next line in the direction it came from is a whole cell away, as in the one it went.
                    turn = entry
                    if crosses_column:
                        column -= step_column
                        step_column = -step_column
                        back_x = -direction_x
                    else:
                        row -= step_row
                        step_row = -step_row
                        back_y = -direction_y
                    continue
            distance = entry
            break
        range_m = range_max_m if distance == range_max else distance * resolution_m
        for k in range(count):
            # |origin + t·direction − center| = radius: t² − 2·along·t + excess = 0, the nearer root.
            center_x, center_y = near[k, 0] - sensor_x_m, near[k, 1] - sensor_y_m
            radius_2 = near[k, 2] * near[k, 2]
            excess = center_x * center_x + center_y * center_y - radius_2
            along = center_x * direction_x + center_y * direction_y
            if excess >= 0 and along > 0 and along * along >= excess:
                hit_m = along - math.sqrt(along * along - excess)
                if turn < 0 or hit_m < turn * resolution_m:
                    range_m = min(range_m, hit_m)
            if turn >= 0:
                turn_m = turn * resolution_m
                center_x -= turn_m * direction_x
                center_y -= turn_m * direction_y
                excess = center_x * center_x + center_y * center_y - radius_2
                along = center_x * back_x + center_y * back_y
                if excess >= 0 and along > 0 and along * along >= excess:
                    range_m = min(range_m, turn_m + along - math.sqrt(along * along - excess))
        ranges_m[ray] = range_m
    return ranges_m
