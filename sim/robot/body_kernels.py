"""Motion of all bodies of an arena in one tick: compiled loops over arrays with a row for each robot.

A length is the root of a sum of squares, which is the same on all processors and in every C library.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.navigation.wheel_bases import TANGENTS, WHEEL_ANGLES_RAD
from robrain.algorithms.numeric.kernel_array import Floats

STATE = np.dtype(
    [
        ("x_m", "f8"),
        ("y_m", "f8"),
        ("yaw_rad", "f8"),
        ("forward_m", "f8"),
        ("left_m", "f8"),
        ("turned_rad", "f8"),
        ("distance_m", "f8"),
    ]
)
"""Pose in the arena frame, displacement of the last tick in the body frame, and the path length since the start."""

WHEELS = np.dtype(
    [
        ("radius_m", "f8"),
        ("distance_m", "f8"),
        ("path_per_turn", "f8", (3,)),
        ("lateral_slip", "f8"),
        ("slip_m2_per_m", "f8"),
        ("lateral_m2_per_m", "f8"),
    ]
)
"""The true wheels of a robot. The last two are variances of slips along the tread: per metre along it, and per metre
along the axle."""

MOTION = 6
"""Columns of a body's motion in the space: x, y, yaw, and their rates, in m, rad and seconds, arena frame."""
_AXLES = tuple((math.cos(angle), math.sin(angle)) for angle in WHEEL_ANGLES_RAD)


@njit(cache=True)
def drive(
    state: NDArray[np.void],
    motion: Floats,
    wheels: NDArray[np.void],
    wanted_rad_s: Floats,
    velocities: Floats,
    tick_s: float,
    speed_change_m_s: float,
    yaw_rate_change_rad_s: float,
) -> None:
    """Bring each body's velocity as near to that of its wheels as the acceleration allows in a tick.

    Args:
        state: (N,) `STATE`.
        motion: (N, `MOTION`).
        wheels: (N,) `WHEELS`.
        wanted_rad_s: (N, 3) speeds of the wheels.
        velocities: (N, 3) x, y and yaw rate in the arena frame: the result.
        tick_s: length of a tick.
        speed_change_m_s: greatest change of the velocity in a tick.
        yaw_rate_change_rad_s: greatest change of the yaw rate in a tick.

    """
    for i in range(state.shape[0]):
        wheel = wheels[i]
        v1 = wheel.radius_m * (wheel.path_per_turn[0] * wanted_rad_s[i, 0])
        v2 = wheel.radius_m * (wheel.path_per_turn[1] * wanted_rad_s[i, 1])
        v3 = wheel.radius_m * (wheel.path_per_turn[2] * wanted_rad_s[i, 2])
        forward_m_s = (2 / 3) * (TANGENTS[0][0] * v1 + TANGENTS[1][0] * v2 + TANGENTS[2][0] * v3)
        left_m_s = (2 / 3) * (TANGENTS[0][1] * v1 + TANGENTS[1][1] * v2 + TANGENTS[2][1] * v3)
        wanted_yaw_rate = (v1 + v2 + v3) / (3 * wheel.distance_m)
        yaw_rate_rad_s = motion[i, 5]
        change_rad_s = wanted_yaw_rate - yaw_rate_rad_s
        yaw_rate_rad_s += max(-yaw_rate_change_rad_s, min(yaw_rate_change_rad_s, change_rad_s))

        # Velocity is constant during a step while the yaw turns: halfway through it is where both agree.
        halfway_rad = state[i].yaw_rad + 0.5 * yaw_rate_rad_s * tick_s
        cos, sin = math.cos(halfway_rad), math.sin(halfway_rad)
        x_m_s, y_m_s = motion[i, 3], motion[i, 4]
        change_x_m_s = cos * forward_m_s - sin * left_m_s - x_m_s
        change_y_m_s = sin * forward_m_s + cos * left_m_s - y_m_s
        change_m_s = math.sqrt(change_x_m_s * change_x_m_s + change_y_m_s * change_y_m_s)
        share = speed_change_m_s / change_m_s if change_m_s > speed_change_m_s else 1.0
        velocities[i, 0] = x_m_s + share * change_x_m_s
        velocities[i, 1] = y_m_s + share * change_y_m_s
        velocities[i, 2] = yaw_rate_rad_s


@njit(cache=True)
def roll(
    state: NDArray[np.void],
    motion: Floats,
    wheels: NDArray[np.void],
    turns_rad: Floats,
    normals: Floats,
    used: NDArray[np.int64],
    refill_at: int,
) -> bool:
    """Update the bodies after a step of the space: pose, displacement, path length and turns of the wheels.

    Args:
        state: (N,) `STATE`, updated in place.
        motion: (N, `MOTION`).
        wheels: (N,) `WHEELS`.
        turns_rad: (N, 3) turn of each wheel since the start; updated in place.
        normals: (N, K) normal random numbers of the slips; at least three of each row must be unused.
        used: (N,) number of used values of each row; updated in place.
        refill_at: number of used values from which a row needs more.

    Returns:
        Whether a row needs more.

    """
    needs_more = False
    for i in range(state.shape[0]):
        body, wheel = state[i], wheels[i]
        dx_m, dy_m = motion[i, 0] - body.x_m, motion[i, 1] - body.y_m
        turned_rad = motion[i, 2] - body.yaw_rad
        halfway_rad = body.yaw_rad + 0.5 * turned_rad
        body.x_m, body.y_m, body.yaw_rad = motion[i, 0], motion[i, 1], motion[i, 2]
        cos, sin = math.cos(halfway_rad), math.sin(halfway_rad)
        forward_m = cos * dx_m + sin * dy_m
        left_m = cos * dy_m - sin * dx_m
        body.forward_m, body.left_m, body.turned_rad = forward_m, left_m, turned_rad
        body.distance_m += math.sqrt(dx_m * dx_m + dy_m * dy_m)

        turning_m = wheel.distance_m * turned_rad
        for k in range(3):
            turn_rad = (TANGENTS[k][0] * forward_m + TANGENTS[k][1] * left_m + turning_m) / wheel.radius_m
            along_axle_m = _AXLES[k][0] * forward_m + _AXLES[k][1] * left_m
            slip_m = wheel.lateral_slip * along_axle_m
            # Of the slip along the tread: a random walk, whose variance grows with the path length.
            along_tread_m2 = wheel.slip_m2_per_m * abs(turn_rad) * wheel.radius_m
            variance_m2 = along_tread_m2 + wheel.lateral_m2_per_m * abs(along_axle_m)
            if variance_m2 > 0:
                slip_m += math.sqrt(variance_m2) * normals[i, used[i]]
                used[i] += 1
            turns_rad[i, k] += (turn_rad + slip_m / wheel.radius_m) / wheel.path_per_turn[k]
        needs_more = needs_more or used[i] >= refill_at
    return needs_more
