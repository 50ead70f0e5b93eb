"""Power that a robot draws from its battery, by activity.

Mei, Lu, Hu, Lee: Energy-Efficient Motion Planning for Mobile Robots, ICRA 2004, fit polynomials to the power of a
robot's motors over their speed. The power is a loss plus m(a + gμ)v, beside constants for sensing, control and
computing. Source: the same authors, A Case Study of Mobile Robot's Energy Consumption and Conservation Techniques, ICAR
2005. Kept here: the constants, the loss, the first order in speed (it grows with the mass) and a second order. Turning
and the energy of speeding up are added. The values are chosen for a base of 4 kg, not measured on one.
"""

import math
from typing import Annotated

import numpy as np
from msgspec import Meta
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import NotNegative, Positive

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
"""A robot's terms of power, its speed in the last tick, and the energy of its motion since the energy was last read."""
AT_REST_BELOW = 1e-3
"""Below a millimetre (milliradian) a second the robot counts as standing."""


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
    """Power of this motion, beyond standing; both speeds may have either sign, the mass is the base's."""
    speed_m_s, yaw_rate_rad_s = abs(speed_m_s), abs(yaw_rate_rad_s)
    if speed_m_s < AT_REST_BELOW and yaw_rate_rad_s < AT_REST_BELOW:
        return 0.0
    rolling_w = speed_w_per_m_s * speed_m_s + yaw_w_per_rad_s * yaw_rate_rad_s
    loaded = 1.0 + payload_kg / mass_kg
    return moving_w + loaded * rolling_w + speed2_w_per_m2_s2 * speed_m_s * speed_m_s


@njit(cache=True)
def add_motion(loads: NDArray[np.void], state: NDArray[np.void], tick_s: float) -> None:
    """Account for a tick: `loads` (N,) `LOAD`, updated in place; `state` (N,) as of `robot_body.STATE`."""
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
            # Braking costs and returns nothing.
            gained_j = (
                0.5 * (load.mass_kg + load.payload_kg) * (speed_m_s * speed_m_s - load.speed_m_s * load.speed_m_s)
            )
            load.motion_j += gained_j / load.drive_efficiency
        load.speed_m_s = speed_m_s


class PowerModel(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Terms of a robot's power. Raises ValueError where it is built with a negative one."""

    idle_w: NotNegative = 2.0
    """Controllers, sensors and radio."""
    compute_w: NotNegative = 6.0
    """The on-board computer."""
    burst_w: NotNegative = 0.0
    """Additional power while the computer has a burst of work; bursts come at random."""
    burst_s: Positive = 4.0
    """Mean length of a burst."""
    between_bursts_s: Positive = 12.0
    """Mean time between two bursts."""
    moving_w: NotNegative = 0.3
    """Power of the motor drivers, while a wheel moves."""
    speed_w_per_m_s: NotNegative = 7.5
    """Rolling, per m/s, without payload."""
    speed2_w_per_m2_s2: NotNegative = 0.0
    """Copper and eddy losses, which grow with the square of the speed."""
    yaw_w_per_rad_s: NotNegative = 1.2
    """Turning, per rad/s, without payload."""
    payload_kg: NotNegative = 0.0
    """Carried mass; it adds to rolling, turning and acceleration."""
    drive_efficiency: Annotated[float, Meta(gt=0, le=1)] = 0.6
    """Share of the motors' power that becomes kinetic energy on acceleration; none is recovered."""

    def idle_total_w(self, *, bursting: bool) -> float:
        """Power of an idle robot."""
        return self.idle_w + self.compute_w + (self.burst_w if bursting else 0.0)

    def motion_w(self, speed_m_s: float, yaw_rate_rad_s: float, mass_kg: float) -> float:
        """Power of this motion, beyond standing; both speeds may have either sign, the mass is the base's."""
        power_w: float = motion_w(
            speed_m_s,
            yaw_rate_rad_s,
            mass_kg,
            self.payload_kg,
            self.moving_w,
            self.speed_w_per_m_s,
            self.speed2_w_per_m2_s2,
            self.yaw_w_per_rad_s,
        )
        return power_w

    def row(self, mass_kg: float) -> tuple[float, ...]:
        """The terms as a row of `LOAD`, for a robot of this mass at rest."""
        return (
            mass_kg,
            self.payload_kg,
            self.moving_w,
            self.speed_w_per_m_s,
            self.speed2_w_per_m2_s2,
            self.yaw_w_per_rad_s,
            self.drive_efficiency,
            0.0,
            0.0,
        )
