"""What a robot draws from its battery, by what it does.

Mei, Lu, Hu, Lee: Energy-Efficient Motion Planning for Mobile Robots, ICRA 2004, fit polynomials to the power of a
robot's motors over their speed; the same authors' A Case Study of Mobile Robot's Energy Consumption and Conservation
Techniques, ICAR 2005, give it as a loss plus m(a + gμ)v, beside constants for sensing, control and computing. Kept
here: the constants, the loss, the first order in speed (it grows with the mass), a second order, turning, and the
energy of speeding up. The values are chosen for a base of 4 kg, not measured on one.
"""

from typing import Annotated

from msgspec import Meta

from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import NotNegative, Positive
from robrain.sim.firmware.load_kernel import acceleration_j, motion_w


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
    """Motor drivers, while anything moves."""
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

    def standing_w(self, *, bursting: bool) -> float:
        """Power of doing nothing."""
        return self.idle_w + self.compute_w + (self.burst_w if bursting else 0.0)

    def motion_w(self, speed_m_s: float, yaw_rate_rad_s: float, mass_kg: float) -> float:
        """Power of going on like this, beyond standing; both speeds may have either sign, the mass is the base's."""
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

    def acceleration_j(self, mass_kg: float, before_m_s: float, after_m_s: float) -> float:
        """Energy of a change of speed of a base of this mass with its payload; braking costs and returns nothing."""
        energy_j: float = acceleration_j(mass_kg, self.payload_kg, self.drive_efficiency, before_m_s, after_m_s)
        return energy_j
