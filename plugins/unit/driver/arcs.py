"""How a base that cannot turn on the spot turns: by arcs forwards and backwards, as a car does in a narrow street.

A car with the tightest turn R drives with |ω| ≤ |v| / R. Where more turn is wanted than its speed allows, it drives
tight arcs to and fro, all of which turn it the same way. Each is as short as `LEG_M`, or as the room there is.

Between two periods the driver's ramp and the speed here are the velocity that was commanded, whichever of them led: so
speed changes by the same limits from one way of driving to the other, and braking sees where the robot really goes.
"""

import math

from robrain.plugins.unit.driver.path import Ramp, RampLimits, speed_to_stop
from robrain.plugins.unit.lookout import Lookout
from robrain.protocol.model.geometry import Pose2D, Twist2D, wrap_angle_rad

ARC_M_S = 0.3
"""Greatest speed of such an arc (chosen)."""
LEG_M = 0.3
"""Length of an arc, of the first one half of it, so that the robot stays where it is (chosen)."""
STANDS_M_S = 0.02
"""Slower than this it changes its direction."""
SLOW_RAD_S = 0.03
"""A turn as slow as this is left out if it cannot be driven."""
ROOM_M = 0.03
"""With less room than this ahead and behind it cannot turn."""


class Arcs:
    """Makes the velocities of a driver's ramp drivable.

    Args:
        lookout: what lies ahead and behind.
        limits: of the speed.
        turn_radius_min_m: radius of the tightest turn.
        period_s: of the commands.
        delay_s: until a command takes effect.

    """

    def __init__(
        self, lookout: Lookout, limits: RampLimits, turn_radius_min_m: float, period_s: float, delay_s: float
    ) -> None:
        self.has_room = True
        """Whether it could move as it was last asked to."""
        self._lookout, self._radius_m, self._delay_s = lookout, turn_radius_min_m, delay_s
        self._speed = Ramp(limits, period_s)
        self._way = 1.0
        self._begin: Pose2D | None = None
        self._leg_m = 0.0

    def stand(self) -> None:
        """Be at rest from now on, however that is brought about."""
        self._speed.stand()
        self._begin, self.has_room = None, True

    def limited(self, speed_m_s: float, rate_rad_s: float) -> Twist2D:
        """A velocity with no more turn than its speed allows."""
        most_rad_s = abs(speed_m_s) / self._radius_m
        return Twist2D(speed_m_s, 0.0, max(-most_rad_s, min(most_rad_s, rate_rad_s)))

    def go_on(self, way: Ramp, axis: tuple[float, float]) -> None:
        """Drive on as the driver's ramp says, for this period."""
        self.has_room, self._begin = True, None
        self._speed.take_along(way, *axis)

    def turn(self, pose: Pose2D, way: Ramp, axis: tuple[float, float], rate_rad_s: float, fastest_m_s: float) -> None:
        """Go on by a period, on an arc if the driver's ramp is too slow for the turn; `way` is then the arc's velocity.

        Args:
            pose: where the robot is, frame odom.
            way: the driver's ramp, a velocity in frame odom along the axis.
            axis: where the robot looks, a unit vector.
            rate_rad_s: the turn that is wanted.
            fastest_m_s: of an arc.

        """
        self.has_room, speed = True, self._speed
        wanted_m_s = abs(axis[0] * way.x + axis[1] * way.y)
        is_enough = abs(rate_rad_s) * self._radius_m <= wanted_m_s or abs(rate_rad_s) < SLOW_RAD_S
        if is_enough and speed.x > -STANDS_M_S:
            self.go_on(way, axis)
            return
        if self._begin is None:
            self._begin, self._leg_m, self._way = pose, 0.5 * LEG_M, 1.0
        to_go_m = self._to_go_m(pose, self._begin)
        if to_go_m < ROOM_M and abs(speed.x) < STANDS_M_S:
            self._begin, self._leg_m, self._way = pose, LEG_M, -self._way
            to_go_m = self._to_go_m(pose, pose)
            self.has_room = to_go_m >= ROOM_M
        to_stop_m_s = 0.0 if is_enough else speed_to_stop(to_go_m, speed.limits.acceleration, self._delay_s)
        speed.follow(self._way * min(ARC_M_S, fastest_m_s, to_stop_m_s), 0.0)
        way.point_along(speed, *axis)

    def _to_go_m(self, pose: Pose2D, begin: Pose2D) -> float:
        """What is left of the arc: of its length, or of the room on the way."""
        axis_rad = pose.yaw_rad if self._way > 0.0 else wrap_angle_rad(pose.yaw_rad + math.pi)
        ahead_m = self._speed.ahead(self._way, 0.0)
        return min(self._leg_m - pose.distance_m(begin), self._lookout.free_m(pose, axis_rad)) - ahead_m
