"""Smooth motion: the speed from which one still stops in time, and velocities of bounded acceleration and jerk."""

import math

import msgspec


class RampLimits(msgspec.Struct, frozen=True):
    """Bounds of one kind of motion, in m or rad and seconds."""

    acceleration: float
    jerk: float


def speed_to_stop(distance: float, acceleration: float, delay_s: float) -> float:
    """The speed from which a deceleration that begins after `delay_s` ends within a distance; 0 if none is left.

    The solution of v·delay + v²/(2a) = distance.
    """
    if distance <= 0.0:
        return 0.0
    return acceleration * (math.sqrt(delay_s * delay_s + 2.0 * distance / acceleration) - delay_s)


class Ramp:
    """A velocity in the plane that follows a wanted one; with y left at 0, along a line or about an axis."""

    def __init__(self, limits: RampLimits, period_s: float) -> None:
        self.limits = limits
        self.x = self.y = 0.0
        """The velocity."""
        self._acceleration_x = self._acceleration_y = 0.0
        self._period_s = period_s

    @property
    def speed(self) -> float:
        """Its length."""
        return math.hypot(self.x, self.y)

    def ahead(self, direction_x: float, direction_y: float) -> float:
        """How far it goes in this direction (a unit vector) before a wish to slow down has its full effect.

        To turn its present acceleration round into the full deceleration takes as long as the jerk allows; until it has
        gone, the speed still grows by its square over twice the jerk.
        """
        limits = self.limits
        speeding_up = max(0.0, direction_x * self._acceleration_x + direction_y * self._acceleration_y)
        lead_s = (0.5 * limits.acceleration + speeding_up) / limits.jerk + 0.5 * self._period_s
        gained = speeding_up * speeding_up / (2.0 * limits.jerk)
        return lead_s * (direction_x * self.x + direction_y * self.y + gained)

    def stopping(self, delay_s: float) -> float:
        """How far it goes until it is at rest, if it begins to slow down smoothly after `delay_s`.

        An S-curve from v to rest takes v²/(2a) + v·a/(2j) (Biagiotti, Melchiorri: Trajectory Planning for Automatic
        Machines and Robots, 2008, section 3.4, for speeds that reach the full deceleration; more than lower ones take).
        """
        speed, limits = self.speed, self.limits
        lag_s = limits.acceleration / (2.0 * limits.jerk) + delay_s
        return speed * (speed / (2.0 * limits.acceleration) + lag_s)

    def stand(self) -> None:
        """Be at rest from now on, however that is brought about."""
        self.x = self.y = self._acceleration_x = self._acceleration_y = 0.0

    def follow(self, wanted_x: float, wanted_y: float) -> None:
        """Go on by a period towards the wanted velocity."""
        period_s, limits = self._period_s, self.limits
        missing_x, missing_y = wanted_x - self.x, wanted_y - self.y
        missing = math.hypot(missing_x, missing_y)
        step = limits.jerk * period_s
        acceleration = math.hypot(self._acceleration_x, self._acceleration_y)
        if missing <= step * period_s and acceleration <= step * 1.001:
            self.x, self.y = wanted_x, wanted_y
            self._acceleration_x = self._acceleration_y = 0.0
            return
        # The greatest acceleration that can still be taken back, a step each period, until nothing is missing.
        aim = math.sqrt(0.25 * step * step + 2.0 * limits.jerk * missing) - 0.5 * step
        aim = min(limits.acceleration, aim, missing / period_s)
        share = aim / missing if missing > 0.0 else 0.0
        change_x = share * missing_x - self._acceleration_x
        change_y = share * missing_y - self._acceleration_y
        change = math.hypot(change_x, change_y)
        share = step / change if change > step else 1.0
        self._acceleration_x += share * change_x
        self._acceleration_y += share * change_y
        self.x += period_s * self._acceleration_x
        self.y += period_s * self._acceleration_y

    def brake(self, deceleration: float) -> None:
        """Go on by a period towards rest, with this deceleration and at once."""
        speed = self.speed
        left = max(0.0, speed - deceleration * self._period_s)
        share = left / speed if speed > 0.0 else 0.0
        self.x, self.y = share * self.x, share * self.y
        self._acceleration_x = self._acceleration_y = 0.0
