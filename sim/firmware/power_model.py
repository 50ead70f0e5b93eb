"""What a robot draws from its battery, by what it does.

Mei, Lu, Hu, Lee: Energy-Efficient Motion Planning for Mobile Robots, ICRA 2004, fit polynomials to the power of a
robot's motors over their speed and add the energy of acceleration and turns. At walking pace the first-order term
is most of it, and it is what is kept here. The values are chosen for a base of 4 kg, not measured on one.
"""

import msgspec


class PowerModel(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Terms of a robot's power. Raises ValueError where it is built with a negative one."""

    idle_w: float = 2.0
    """Controllers, sensors and radio."""
    compute_w: float = 6.0
    """The on-board computer."""
    moving_w: float = 0.3
    """Motor drivers while anything moves."""
    speed_w_per_m_s: float = 7.5
    """Rolling, at each m/s."""
    yaw_w_per_rad_s: float = 1.2
    """Turning, at each rad/s."""
    drive_efficiency: float = 0.6
    """Share of the motors' power that becomes kinetic energy when the robot speeds up; none comes back."""

    def __post_init__(self) -> None:
        for name in ("idle_w", "compute_w", "moving_w", "speed_w_per_m_s", "yaw_w_per_rad_s"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"expected {name} >= 0, got {getattr(self, name)}")
        if not 0 < self.drive_efficiency <= 1:
            raise ValueError(f"expected drive_efficiency in (0, 1], got {self.drive_efficiency}")

    def motion_w(self, speed_m_s: float, yaw_rate_rad_s: float) -> float:
        """Power of going on like this, beyond idle and compute; both speeds may have either sign."""
        speed_m_s, yaw_rate_rad_s = abs(speed_m_s), abs(yaw_rate_rad_s)
        if speed_m_s < _STANDING and yaw_rate_rad_s < _STANDING:
            return 0.0
        return self.moving_w + self.speed_w_per_m_s * speed_m_s + self.yaw_w_per_rad_s * yaw_rate_rad_s

    def acceleration_j(self, mass_kg: float, before_m_s: float, after_m_s: float) -> float:
        """Energy of a change of speed; braking costs and returns nothing."""
        gained_j = 0.5 * mass_kg * (after_m_s * after_m_s - before_m_s * before_m_s)
        return max(0.0, gained_j) / self.drive_efficiency


_STANDING = 1e-3
"""Below a millimetre (milliradian) a second nothing moves."""
