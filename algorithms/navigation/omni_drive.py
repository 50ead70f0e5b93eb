"""Kinematics of a base with three omni wheels at 120°.

Wheel i stands at angle α_i from the robot's x axis, at distance L from its centre, and drives along the tangent:
v_i = −sin α_i · v_x + cos α_i · v_y + L · ω (Siegwart, Nourbakhsh, Scaramuzza: Introduction to Autonomous Mobile
Robots, 2nd ed., section 3.2.5, Swedish wheel with γ = 0).
"""

import math

import msgspec

from robrain.protocol.model.geometry import Twist2D
from robrain.protocol.model.ranges import check_positive

WHEEL_ANGLES_RAD = (math.radians(60.0), math.radians(180.0), math.radians(300.0))


class OmniBase(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="type", tag="omni3"):
    """Size of the base. The defaults are chosen in the manner of the Robertino; no data sheet was found."""

    wheel_radius_m: float = 0.04
    wheel_distance_m: float = 0.155
    """From the robot's centre to a wheel."""
    encoder_ticks_per_turn: int = 4096

    def __post_init__(self) -> None:
        check_positive(self, "wheel_radius_m", "wheel_distance_m", "encoder_ticks_per_turn")

    @property
    def is_holonomic(self) -> bool:
        """Whether it can drive sideways."""
        return True

    @property
    def turn_radius_min_m(self) -> float:
        """0: it turns on the spot."""
        return 0.0

    @property
    def wheels(self) -> int:
        """Number of wheels."""
        return len(WHEEL_ANGLES_RAD)

    @property
    def rad_per_tick(self) -> float:
        """Turn of a wheel between two encoder ticks."""
        return 2 * math.pi / self.encoder_ticks_per_turn

    def wheel_speeds_rad_s(self, twist: Twist2D) -> tuple[float, float, float]:
        """Inverse kinematics: wheel speeds for a velocity in the body frame."""
        radius, distance = self.wheel_radius_m, self.wheel_distance_m
        vx, vy, turning = twist.forward_m_s, twist.left_m_s, distance * twist.yaw_rad_s
        return (
            (TANGENTS[0][0] * vx + TANGENTS[0][1] * vy + turning) / radius,
            (TANGENTS[1][0] * vx + TANGENTS[1][1] * vy + turning) / radius,
            (TANGENTS[2][0] * vx + TANGENTS[2][1] * vy + turning) / radius,
        )

    def commands(self, twist: Twist2D, wheel_speed_max_rad_s: float) -> tuple[float, ...]:
        """Wheel speeds for a velocity, slower in proportion if one were too fast."""
        first, second, third = self.wheel_speeds_rad_s(twist)
        share = wheel_speed_max_rad_s / max(wheel_speed_max_rad_s, abs(first), abs(second), abs(third))
        return share * first, share * second, share * third

    def twist(self, wheel_1_rad_s: float, wheel_2_rad_s: float, wheel_3_rad_s: float) -> Twist2D:
        """Forward kinematics: velocity in the body frame from wheel speeds (also turns → displacement)."""
        radius = self.wheel_radius_m
        v1, v2, v3 = radius * wheel_1_rad_s, radius * wheel_2_rad_s, radius * wheel_3_rad_s
        # The three tangents add up to zero and are orthogonal to each other's sum: the inverse is 2/3 the transpose.
        return Twist2D(
            (2 / 3) * (TANGENTS[0][0] * v1 + TANGENTS[1][0] * v2 + TANGENTS[2][0] * v3),
            (2 / 3) * (TANGENTS[0][1] * v1 + TANGENTS[1][1] * v2 + TANGENTS[2][1] * v3),
            (v1 + v2 + v3) / (3 * self.wheel_distance_m),
        )


TANGENTS = tuple((-math.sin(angle), math.cos(angle)) for angle in WHEEL_ANGLES_RAD)
"""Unit vectors along which the wheels drive, robot's frame."""
