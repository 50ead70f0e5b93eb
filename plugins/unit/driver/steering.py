"""Converts the ramps' velocity to one that the base can drive, and limits its speed.

A base that cannot drive sideways turns towards where it wants to go. It drives with the share of its wish that points
along its own axis, and slower the less it faces the wish. It thus turns on the spot where the path bends sharply.
"""

import math

from robrain.plugins.device.mocdevice.interface import MocDeviceInterface
from robrain.plugins.unit.driver.path import PERIOD_S, Ramp, RampLimits, speed_to_stop
from robrain.plugins.unit.obstacle_distance import Lookout
from robrain.protocol.model.geometry import Pose2D, Twist2D, wrap_angle_rad

ARC_M_S = 0.3
"""Greatest speed of such an arc (chosen)."""
LEG_M = 0.3
"""Length of an arc, of the first one half of it, so that the robot stays where it is (chosen)."""
STILL_M_S = 0.02
"""Slower than this it changes its direction."""
SLOW_RAD_S = 0.03
"""A turn as slow as this is omitted if it cannot be driven."""
ROOM_M = 0.03
"""With less room than this ahead and behind it cannot turn."""


class Arcs:
    """Makes the velocities of a driver's ramp drivable.

    Args:
        lookout: obstacles ahead and behind.
        limits: of the speed.
        turn_radius_min_m: radius of the tightest turn.

    """

    def __init__(self, lookout: Lookout, limits: RampLimits, turn_radius_min_m: float) -> None:
        self.has_room = True
        """Whether the last commanded motion was possible."""
        self._lookout, self._radius_m = lookout, turn_radius_min_m
        self._speed = Ramp(limits)
        self._direction = 1.0
        self._begin: Pose2D | None = None
        self._leg_m = 0.0

    def stop(self) -> None:
        """Reset to rest."""
        self._speed.stop()
        self._begin, self.has_room = None, True

    def limited(self, speed_m_s: float, rate_rad_s: float) -> Twist2D:
        """A velocity with no more turn than its speed allows."""
        most_rad_s = abs(speed_m_s) / self._radius_m
        return Twist2D(speed_m_s, 0.0, max(-most_rad_s, min(most_rad_s, rate_rad_s)))

    def go_on(self, ramp: Ramp, axis: tuple[float, float]) -> None:
        """Drive on by the driver's ramp, for this period."""
        self.has_room, self._begin = True, None
        self._speed.carry(ramp, *axis)

    def turn(self, pose: Pose2D, ramp: Ramp, axis: tuple[float, float], rate_rad_s: float, fastest_m_s: float) -> None:
        """Advance by a period, on an arc if the driver's ramp is too slow for the turn; `ramp` then has the arc's.

        Args:
            pose: where the robot is, frame odom.
            ramp: the driver's ramp, a velocity in frame odom along the axis.
            axis: the robot's heading, a unit vector.
            rate_rad_s: the turn that is wanted.
            fastest_m_s: of an arc.

        """
        self.has_room, speed = True, self._speed
        wanted_m_s = abs(axis[0] * ramp.x + axis[1] * ramp.y)
        is_enough = abs(rate_rad_s) * self._radius_m <= wanted_m_s or abs(rate_rad_s) < SLOW_RAD_S
        if is_enough and speed.x > -STILL_M_S:
            self.go_on(ramp, axis)
            return
        if self._begin is None:
            self._begin, self._leg_m, self._direction = pose, 0.5 * LEG_M, 1.0
        to_go_m = self._to_go_m(pose, self._begin)
        if to_go_m < ROOM_M and abs(speed.x) < STILL_M_S:
            self._begin, self._leg_m, self._direction = pose, LEG_M, -self._direction
            to_go_m = self._to_go_m(pose, pose)
            self.has_room = to_go_m >= ROOM_M
        to_stop_m_s = 0.0 if is_enough else speed_to_stop(to_go_m, speed.limits.acceleration)
        speed.follow(self._direction * min(ARC_M_S, fastest_m_s, to_stop_m_s), 0.0)
        ramp.point_along(speed, *axis)

    def _to_go_m(self, pose: Pose2D, begin: Pose2D) -> float:
        """Remaining length of the arc, limited by the free room on it."""
        axis_rad = pose.yaw_rad if self._direction > 0.0 else wrap_angle_rad(pose.yaw_rad + math.pi)
        ahead_m = self._speed.ahead(self._direction, 0.0)
        return min(self._leg_m - pose.distance_m(begin), self._lookout.free_m(pose, axis_rad)) - ahead_m


SLOW_M_S = 0.05
"""Below this it does not matter where the robot still drifts."""
SPARE_M = 0.04
"""Share of the stop distance that may be used up before it brakes hard."""


class Steering:
    """Moves the ramps of a driver.

    Args:
        lookout: obstacles ahead.
        way: the ramp of the body's velocity, frame odom.
        turn: the ramp of its turn rate.
        turn_rate_rad_s: greatest turn rate.
        braking_m_s2: for obstacles too near for a smooth stop.
        moc: the base.

    """

    def __init__(
        self,
        lookout: Lookout,
        ramp: Ramp,
        turn: Ramp,
        *,
        turn_rate_rad_s: float,
        braking_m_s2: float,
        moc: MocDeviceInterface,
    ) -> None:
        self.arcs: Arcs | None = None
        """Of a base that cannot turn on the spot."""
        if turn_radius_min_m := moc.turn_radius_min_m():
            self.arcs = Arcs(lookout, ramp.limits, turn_radius_min_m)
        self.is_holonomic = moc.is_holonomic()
        self._brakes = False
        """Whether it brakes hard in this period."""
        self._lookout, self._ramp, self._turn = lookout, ramp, turn
        self._turn_rate_rad_s, self._braking_m_s2 = turn_rate_rad_s, braking_m_s2

    def go_towards(
        self,
        pose: Pose2D,
        heading_rad: float,
        speed_m_s: float,
        free_m: float,
        ahead_m: float,
        *,
        may_reverse: bool = False,
    ) -> None:
        """Advance by a period towards this velocity, frame odom, or slower if obstacles ahead demand it.

        Args:
            pose: where the robot is, frame odom.
            heading_rad: direction of the velocity.
            speed_m_s: at most.
            free_m: room in that direction.
            ahead_m: distance driven before a wish to slow down has its effect, see `Ramp.ahead`.
            may_reverse: as for `twist`.

        """
        ramp, acceleration = self._ramp, self._ramp.limits.acceleration
        if self.goes_too_fast(pose):
            self.brake()
            return
        if not self.is_holonomic:
            speed_m_s = speed_m_s * self._share(pose, heading_rad, may_reverse=may_reverse)
            is_back = math.cos(heading_rad - pose.yaw_rad) < 0.0
            axis_rad = wrap_angle_rad(pose.yaw_rad + math.pi) if is_back else pose.yaw_rad
            free_m = min(free_m, self._lookout.free_m(pose, axis_rad))
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        to_stop_m_s = speed_to_stop(free_m - ahead_m, acceleration)
        ramp.follow(min(speed_m_s, to_stop_m_s) * cos, min(speed_m_s, to_stop_m_s) * sin)

    def go(self, pose: Pose2D, velocity_m_s: tuple[float, float]) -> float:
        """Advance by a period towards a velocity (x, y), frame odom; returns its direction."""
        x_m_s, y_m_s = velocity_m_s
        heading_rad = math.atan2(y_m_s, x_m_s)
        share = 1.0 if self.is_holonomic else self._share(pose, heading_rad)
        self._ramp.follow(share * x_m_s, share * y_m_s)
        return heading_rad

    def brake(self) -> None:
        """Advance by a period towards rest, as hard as the wheels' grip permits."""
        self._ramp.brake(self._braking_m_s2)
        self._brakes = True

    def slow_down(self, pose: Pose2D) -> None:
        """Advance by a period towards rest, hard only if there is no room for a smooth stop."""
        if self.goes_too_fast(pose):
            self.brake()
        else:
            self._ramp.follow(0.0, 0.0)

    def goes_too_fast(self, pose: Pose2D) -> bool:
        """Whether it cannot stop smoothly enough before an obstacle on its real course, as past a corner."""
        ramp = self._ramp
        if math.hypot(ramp.x, ramp.y) < SLOW_M_S:
            return False
        free_m = self._lookout.free_m(pose, math.atan2(ramp.y, ramp.x))
        return ramp.stopping() > free_m + SPARE_M

    def turn_by(self, angle_rad: float) -> None:
        """Advance by a period with a turn that has this angle remaining."""
        turn = self._turn
        left_rad = abs(angle_rad) - turn.ahead(math.copysign(1.0, angle_rad), 0.0)
        stop_rad_s = speed_to_stop(left_rad, turn.limits.acceleration)
        turn.follow(math.copysign(min(self._turn_rate_rad_s, stop_rad_s), angle_rad), 0.0)

    def twist(self, pose: Pose2D, *, may_reverse: bool = False, fastest_m_s: float = math.inf) -> Twist2D:
        """The ramps' velocity in the body frame, as the base can drive it.

        Args:
            pose: where the robot is.
            may_reverse: whether a base that cannot drive sideways may drive backwards. A base that cannot turn on the
                spot then does not turn by driving to and fro.
            fastest_m_s: of the arcs by which such a base turns.

        """
        ramp, rate_rad_s = self._ramp, self._turn.x
        # The command holds for a period, in which the body turns: it is meant for the middle of it.
        yaw_rad = pose.yaw_rad + 0.5 * PERIOD_S * rate_rad_s
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        if self.is_holonomic:
            return Twist2D(cos * ramp.x + sin * ramp.y, cos * ramp.y - sin * ramp.x, rate_rad_s)
        ramp.keep_along(cos, sin, may_reverse=may_reverse or self.arcs is not None)
        if self.arcs is None:
            return Twist2D(cos * ramp.x + sin * ramp.y, 0.0, rate_rad_s)
        if may_reverse or self._brakes:
            self.arcs.go_on(ramp, (cos, sin))
        else:
            self.arcs.turn(pose, ramp, (cos, sin), rate_rad_s, fastest_m_s)
        self._brakes = False
        return self.arcs.limited(cos * ramp.x + sin * ramp.y, rate_rad_s)

    def stop(self) -> None:
        """Reset to rest."""
        self._ramp.stop()
        self._turn.stop()
        if self.arcs is not None:
            self.arcs.stop()

    def _share(self, pose: Pose2D, heading_rad: float, *, may_reverse: bool = False) -> float:
        """Share of a speed that it drives while it does not face this direction yet, or faces away from it."""
        facing = math.cos(heading_rad - pose.yaw_rad)
        if self.arcs is not None and facing < 0.0 and not may_reverse:
            return 0.0  # backwards only on arcs
        return facing * facing
