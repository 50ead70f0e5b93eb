"""Find the beams of a scan that ended at another robot, so that robots are neither matched nor mapped as walls.

Each teammate publishes its pose, but either robot's pose may be wrong. So a free-standing round object of the
teammate's size near the published place counts as the teammate as well.
"""

import math

import numpy as np
from numba import njit

from robrain.algorithms.numeric.kernel_array import FLOAT64, Floats, kernel_array
from robrain.protocol.model.geometry import Pose2D

MARGIN_M = 0.15
"""Metres from a teammate's hull within which a beam's end counts as the teammate."""
REACH_M = 0.8
"""Largest distance, metres, between a teammate's published and observed place. Both poses may be wrong."""
JUMP_M = 0.25
"""Difference between the ranges of neighbouring beams, metres, above which they end at different objects."""
THROUGH_M = 0.5
"""Distance behind the middle of a teammate's place at which a beam has gone through it. Teammates move meanwhile."""
TOLERANCE_M = 1e-6
"""More than rounding errors of distances."""
ROUND_M = 0.06
"""Largest distance, metres, of the beams' ends from a circle of the teammate's radius."""


def robot_circles(angles_rad: Floats, ranges_m: Floats, range_max_m: float, sensor: Pose2D, reported: Floats) -> Floats:
    """Circles (at most 2 K, 3) x, y, radius in metres, arena frame; a beam that ends in one did not end at a wall.

    Args:
        angles_rad: (N,) directions of the beams in the sensor's frame, in order.
        ranges_m: (N,) their ranges.
        range_max_m: a range that is not less means that nothing was hit.
        sensor: the sensor's pose, arena frame.
        reported: (K, 3) published places of the teammates and their radii, metres, arena frame.

    """
    if not len(reported):
        return np.empty((0, 3))
    return _robot_circles(
        kernel_array(angles_rad, FLOAT64),
        kernel_array(ranges_m, FLOAT64),
        float(range_max_m),
        float(sensor.x_m),
        float(sensor.y_m),
        float(sensor.yaw_rad),
        kernel_array(reported, FLOAT64),
    )


def wall_ends(angles_rad: Floats, ranges_m: Floats, range_max_m: float, sensor: Pose2D, circles: Floats) -> Floats:
    """(n, 2) ends of the beams, sensor's frame, metres, that lie in none of the circles (K, 3), arena frame.

    Without circles they are those of `scan_match.beam_ends`. Raises ValueError for arrays that do not fit.
    """
    if angles_rad.shape != ranges_m.shape or angles_rad.ndim != 1:
        raise ValueError(f"expected (N,) angles and ranges, got {angles_rad.shape} and {ranges_m.shape}")
    ends: Floats = _wall_ends(
        kernel_array(angles_rad, FLOAT64),
        kernel_array(ranges_m, FLOAT64),
        float(range_max_m),
        float(sensor.x_m),
        float(sensor.y_m),
        float(sensor.yaw_rad),
        kernel_array(circles, FLOAT64),
    )
    return ends


def sees_through(angles_rad: Floats, ranges_m: Floats, range_max_m: float, sensor: Pose2D, reported: Floats) -> bool:
    """Whether a teammate is not at its published place: beams go clear through the middle of the place.

    Arguments are those of `robot_circles`. Where walls or others hide the place, the result is False.
    """
    for x_m, y_m, radius_m in reported.tolist():
        away_m = math.hypot(x_m - sensor.x_m, y_m - sensor.y_m)
        if not THROUGH_M + radius_m < away_m < range_max_m - THROUGH_M:
            continue
        bearing_rad = math.atan2(y_m - sensor.y_m, x_m - sensor.x_m) - sensor.yaw_rad
        off_rad = np.abs(np.remainder(angles_rad - bearing_rad + math.pi, math.tau) - math.pi)
        within = off_rad < 0.5 * radius_m / away_m
        if within.any() and bool((ranges_m[within] > away_m + THROUGH_M).all()):
            return True
    return False


@njit(cache=True, nogil=True)
def _wall_ends(
    angles_rad: Floats, ranges_m: Floats, range_max_m: float, x_m: float, y_m: float, yaw_rad: float, circles: Floats
) -> Floats:
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    ends = np.empty((angles_rad.shape[0], 2))
    count = 0
    for n in range(angles_rad.shape[0]):
        if not 0.0 < ranges_m[n] < range_max_m:
            continue
        end_x, end_y = ranges_m[n] * math.cos(angles_rad[n]), ranges_m[n] * math.sin(angles_rad[n])
        at_x, at_y = x_m + cos * end_x - sin * end_y, y_m + sin * end_x + cos * end_y
        is_outside = True
        for k in range(circles.shape[0]):
            if (at_x - circles[k, 0]) ** 2 + (at_y - circles[k, 1]) ** 2 <= circles[k, 2] ** 2:
                is_outside = False
                break
        if is_outside:
            ends[count, 0], ends[count, 1] = end_x, end_y
            count += 1
    return ends[:count]


@njit(cache=True, nogil=True)
def _robot_circles(
    angles_rad: Floats, ranges_m: Floats, range_max_m: float, x_m: float, y_m: float, yaw_rad: float, reported: Floats
) -> Floats:
    beams = angles_rad.shape[0]
    is_round_trip = beams > 1 and (angles_rad[-1] - angles_rad[0]) * beams / (beams - 1) > 0.99 * math.tau
    circles = np.empty((2 * reported.shape[0], 3))
    count = 0
    for k in range(reported.shape[0]):
        radius_m = reported[k, 2]
        away_m = math.hypot(reported[k, 0] - x_m, reported[k, 1] - y_m)
        if away_m > range_max_m + REACH_M + radius_m:
            continue
        circles[count, 0], circles[count, 1], circles[count, 2] = reported[k, 0], reported[k, 1], radius_m + MARGIN_M
        count += 1
        # Of the free-standing round objects as wide as the teammate, the one nearest to the published place.
        nearest_m = REACH_M
        found_x = found_y = 0.0
        first = 0
        while first < beams:
            if not 0.0 < ranges_m[first] < range_max_m or abs(ranges_m[first] - ranges_m[first - 1]) <= JUMP_M:
                first += 1
                continue
            # In a scan of a full circle the last beam and the first are neighbours.
            last, end = first, first + beams - 1 if is_round_trip else beams - 1
            while last < end and abs(ranges_m[(last + 1) % beams] - ranges_m[last % beams]) <= JUMP_M:
                last += 1
            following = ranges_m[(last + 1) % beams]
            is_before = ranges_m[first] < ranges_m[first - 1] and ranges_m[last % beams] < following
            middle = (first + last) // 2
            reach_m = ranges_m[middle % beams] + radius_m
            may_be_it = abs(reach_m - away_m) < nearest_m + TOLERANCE_M  # else its middle is farther away
            if may_be_it and is_before and ranges_m[last % beams] < range_max_m and reach_m > radius_m:
                half_rad = math.asin(min(1.0, radius_m / reach_m))
                last_rad = angles_rad[last % beams] + (math.tau if last >= beams else 0.0)
                spread_rad = last_rad - angles_rad[first]
                angle = yaw_rad + 0.5 * (angles_rad[first] + last_rad)
                center_x, center_y = x_m + reach_m * math.cos(angle), y_m + reach_m * math.sin(angle)
                off_m = math.hypot(center_x - reported[k, 0], center_y - reported[k, 1])
                if off_m < nearest_m and spread_rad <= 2.2 * half_rad:
                    is_round = True
                    for beam in range(first, last + 1):
                        n = beam % beams
                        end_x = x_m + ranges_m[n] * math.cos(yaw_rad + angles_rad[n])
                        end_y = y_m + ranges_m[n] * math.sin(yaw_rad + angles_rad[n])
                        if abs(math.hypot(end_x - center_x, end_y - center_y) - radius_m) > ROUND_M:
                            is_round = False
                            break
                    if is_round:
                        nearest_m, found_x, found_y = off_m, center_x, center_y
            first = last + 1
        if nearest_m < REACH_M:
            circles[count, 0], circles[count, 1], circles[count, 2] = found_x, found_y, radius_m + MARGIN_M
            count += 1
    return circles[:count]
