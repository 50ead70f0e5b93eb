"""Energy of motion: of one robot as plain functions, and of all robots of an arena in one compiled loop."""

import math

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

LOAD = np.dtype(
    [
        ("mass_kg", "f8"),
        ("payload_kg", "f8"),
        ("moving_w", "f8"),
        ("speed_w_per_m_s", "f8"),
        ("speed2_w_per_m2_s2", "f8"),
        ("yaw_w_per_rad_s", "f8"),
        ("drive_efficiency", "f8"),
        ("speed_m_s", "f8"),
        ("motion_j", "f8"),
    ]
)
"""A robot's terms of power, its speed in the last tick, and the energy of its motion since somebody took it away."""
STANDING = 1e-3
"""Below a millimetre (milliradian) a second nothing moves."""


@register_jitable
def motion_w(
    speed_m_s: float,
    yaw_rate_rad_s: float,
    mass_kg: float,
    payload_kg: float,
    moving_w: float,
    speed_w_per_m_s: float,
    speed2_w_per_m2_s2: float,
    yaw_w_per_rad_s: float,
) -> float:
    """Power of going on like this, beyond standing; both speeds may have either sign, the mass is the base's."""
    speed_m_s, yaw_rate_rad_s = abs(speed_m_s), abs(yaw_rate_rad_s)
    if speed_m_s < STANDING and yaw_rate_rad_s < STANDING:
        return 0.0
    rolling_w = speed_w_per_m_s * speed_m_s + yaw_w_per_rad_s * yaw_rate_rad_s
    loaded = 1.0 + payload_kg / mass_kg
    return moving_w + loaded * rolling_w + speed2_w_per_m2_s2 * speed_m_s * speed_m_s


@register_jitable
def acceleration_j(
    mass_kg: float, payload_kg: float, drive_efficiency: float, before_m_s: float, after_m_s: float
) -> float:
    """Energy of a change of speed of a base of this mass with its payload; braking costs and returns nothing."""
    gained_j = 0.5 * (mass_kg + payload_kg) * (after_m_s * after_m_s - before_m_s * before_m_s)
    return max(0.0, gained_j) / drive_efficiency


@njit(cache=True)
def add_motion(loads: NDArray[np.void], state: NDArray[np.void], tick_s: float) -> None:
    """Account for a tick: `loads` (N,) `LOAD`, moved on in place; `state` (N,) as of `body_kernels.STATE`."""
    per_tick = 1.0 / tick_s
    for i in range(loads.shape[0]):
        load, body = loads[i], state[i]
        speed_m_s = math.sqrt(body.forward_m * body.forward_m + body.left_m * body.left_m) * per_tick
        yaw_rate_rad_s = body.turned_rad * per_tick
        if speed_m_s != 0.0 or yaw_rate_rad_s != 0.0:
            load.motion_j += tick_s * motion_w(
                speed_m_s,
                yaw_rate_rad_s,
                load.mass_kg,
                load.payload_kg,
                load.moving_w,
                load.speed_w_per_m_s,
                load.speed2_w_per_m2_s2,
                load.yaw_w_per_rad_s,
            )
        if speed_m_s > load.speed_m_s:
            load.motion_j += acceleration_j(
                load.mass_kg, load.payload_kg, load.drive_efficiency, load.speed_m_s, speed_m_s
            )
        load.speed_m_s = speed_m_s
