"""A path that the driver follows, how fast it can be driven, and the smooth motion along it.

The speed leaves room to stop in time; velocities have bounded acceleration and jerk.
"""

import itertools
import math

import msgspec

from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.model.geometry import Point2D, Pose2D, wrap_angle_rad
from robrain.protocol.model.ranges import METRES_MAX

PERIOD_S = 0.06
"""Period of the driver's commands."""
DELAY_S = PERIOD_S + 0.02
"""Largest delay from the pose of a decision until the wheels obey."""
CORNER_M = 0.25
"""A waypoint that is not the last counts as passed within this."""
NARROW_CORNER_M = 0.15
"""`CORNER_M` on a path through narrow places."""
TANGENT_M = 0.2
MOVED_M = 0.05
STUCK_NS = 3_000_000_000
"""A robot that has not moved by `MOVED_M` for this long does not fit; creeping takes a third of the time."""
SAME_DIRECTION_RAD = math.radians(60.0)
"""Two paths whose next points lie within this angle lead in the same direction."""
LOOK_AHEAD_M = 1.5
"""Corners farther off do not matter yet at any speed of a small robot."""


class Path:
    """Points to drive along, frame odom.

    Args:
        points: at least one; the last is the goal.
        arrived_m: the goal is reached within this.
        yaw_rad: heading on the path; the driving direction if None.
        turned_rad: the goal is reached only within this error of the heading; at any heading if None.
        fastest_m_s: never faster than this.
        is_narrow: whether it leads through narrow places, where the robot has to squeeze.
        is_straight: whether it is driven without turning, also backwards. The goal is then reached once the robot has
            gone as far, even if it is beside the goal.
        steers: whether the base cannot drive sideways: it faces its driving direction until it is at the goal.

    """

    def __init__(
        self,
        points: list[Point2D],
        arrived_m: float,
        yaw_rad: float | None = None,
        turned_rad: float | None = None,
        fastest_m_s: float = math.inf,
        *,
        is_narrow: bool = False,
        is_straight: bool = False,
        steers: bool = False,
    ) -> None:
        self.is_narrow = is_narrow
        self.is_straight, self._steers = is_straight and steers, steers
        self._corner_m = NARROW_CORNER_M if is_narrow else CORNER_M
        self.arrived_m = arrived_m
        self.fastest_m_s = fastest_m_s
        self.yaw_rad = yaw_rad
        self._turned_rad = turned_rad
        self._points = list(points)
        self._moved_from: Pose2D | None = None
        self._moved_ns = 0

    @property
    def target(self) -> Point2D:
        """The point that is driven to now."""
        return self._points[0]

    @property
    def goal(self) -> Point2D:
        """The last point."""
        return self._points[-1]

    def pass_points(self, pose: Pose2D) -> None:
        """Drop the corners that have been reached."""
        points, x_m, y_m = self._points, pose.x_m, pose.y_m
        while len(points) > 1 and math.hypot(x_m - points[0].x_m, y_m - points[0].y_m) < self._corner_m:
            points.pop(0)

    def is_at_goal(self, pose: Pose2D) -> bool:
        """Whether the goal's place has been reached."""
        if self.is_straight and self.yaw_rad is not None:
            goal, yaw_rad = self.goal, self.yaw_rad
            left_m = (goal.x_m - pose.x_m) * math.cos(yaw_rad) + (goal.y_m - pose.y_m) * math.sin(yaw_rad)
            return abs(left_m) < self.arrived_m
        return len(self._points) == 1 and pose.distance_m(self._points[0]) < self.arrived_m

    def is_done(self, pose: Pose2D) -> bool:
        """Whether the goal has been reached, and the robot has its goal heading."""
        return self.is_at_goal(pose) and (
            self._turned_rad is None or abs(self.to_turn_rad(pose, 0.0)) < self._turned_rad
        )

    def remaining_m(self, pose: Pose2D) -> float:
        """Length of the remaining path."""
        before: Point2D | Pose2D = pose
        length_m = 0.0
        for point in self._points:  # at each step: a call for each point would cost a fiftieth of all calls
            length_m += math.hypot(point.x_m - before.x_m, point.y_m - before.y_m)
            before = point
        return length_m

    def along_rad(self, pose: Pose2D) -> float:
        """Direction of the next `TANGENT_M` of path beyond its target; towards the target if that is the last point."""
        begin: Point2D | Pose2D = self._points[0] if len(self._points) > 1 else pose
        left_m = TANGENT_M
        end = self._points[0]
        for one, other in itertools.pairwise(self._points):
            length_m = math.hypot(other.x_m - one.x_m, other.y_m - one.y_m)
            share = min(1.0, left_m / length_m) if length_m > 0.0 else 1.0
            end = Point2D(one.x_m + share * (other.x_m - one.x_m), one.y_m + share * (other.y_m - one.y_m))
            left_m -= length_m
            if left_m <= 0.0:
                break
        return math.atan2(end.y_m - begin.y_m, end.x_m - begin.x_m)

    def to_turn_rad(self, pose: Pose2D, bearing_rad: float) -> float:
        """Turn to the wanted heading, with the target at `bearing_rad` of the robot's frame."""
        if self.yaw_rad is None or (self._steers and not self.is_straight and not self.is_at_goal(pose)):
            return bearing_rad
        return wrap_angle_rad(self.yaw_rad - pose.yaw_rad)

    def copy_progress(self, before: "Path", pose: Pose2D) -> None:
        """Keep the `is_stuck` of the path before if both lead in the same direction from `pose`.

        A behavior that replans every two seconds would never learn that the robot is stuck otherwise.
        """
        self.pass_points(pose)
        turned_rad = wrap_angle_rad(self._bearing_rad(pose) - before._bearing_rad(pose))
        if abs(turned_rad) < SAME_DIRECTION_RAD:
            self._moved_from, self._moved_ns = before._moved_from, before._moved_ns

    def _bearing_rad(self, pose: Pose2D) -> float:
        return math.atan2(self.target.y_m - pose.y_m, self.target.x_m - pose.x_m)

    def forget_progress(self) -> None:
        """Start over with `is_stuck`: the robot sets out, or is not in a narrow place."""
        self._moved_from = None

    def is_stuck(self, pose: Pose2D, now_ns: int) -> bool:
        """Whether the robot has not moved by `MOVED_M` for `STUCK_NS` in a narrow place."""
        if self._moved_from is None or pose.distance_m(self._moved_from) > MOVED_M:
            self._moved_from, self._moved_ns = pose, now_ns
        return now_ns - self._moved_ns > STUCK_NS

    def speed_m_s(self, pose: Pose2D, acceleration_m_s2: float, ahead_m: float) -> float:
        """Speed on the path ahead: at rest at its end, and slow enough at each corner before.

        `ahead_m` is driven before a wish to slow down has its effect, see `Ramp.ahead`.

        At a corner the velocity changes by 2·v·sin(θ/2). With the acceleration a this takes v·sin(θ/2)/a before the
        corner and the same time after it. A blend that begins d before the corner therefore allows v² = a·d / sin(θ/2).
        """
        first = self._points[0]
        left_m = math.hypot(pose.x_m - first.x_m, pose.y_m - first.y_m) - ahead_m
        fastest_m_s = math.inf
        before: Point2D | Pose2D = pose
        for corner, after in itertools.pairwise(self._points):
            if left_m > LOOK_AHEAD_M:
                return fastest_m_s
            angle_rad = math.atan2(after.y_m - corner.y_m, after.x_m - corner.x_m) - math.atan2(
                corner.y_m - before.y_m, corner.x_m - before.x_m
            )
            bend = abs(math.sin(0.5 * angle_rad))
            if bend > 1e-3:
                through_m_s = math.sqrt(acceleration_m_s2 * self._corner_m / bend)
                slack_m = max(0.0, left_m - self._corner_m)
                fastest_m_s = min(fastest_m_s, through_m_s + speed_to_stop(slack_m, acceleration_m_s2))
            left_m += math.hypot(after.x_m - corner.x_m, after.y_m - corner.y_m)
            before = corner
        return min(fastest_m_s, speed_to_stop(left_m, acceleration_m_s2))


class RampLimits(msgspec.Struct, frozen=True):
    """Bounds of one kind of motion, in m or rad and seconds."""

    acceleration: float
    jerk: float


def speed_to_stop(distance: float, acceleration: float) -> float:
    """The speed from which a deceleration that begins after `DELAY_S` ends within a distance; 0 if none remains.

    The solution of v·delay + v²/(2a) = distance.
    """
    if distance <= 0.0:
        return 0.0
    return acceleration * (math.sqrt(DELAY_S * DELAY_S + 2.0 * distance / acceleration) - DELAY_S)


class Ramp:
    """A velocity in the plane that follows a wanted one; with y left at 0, along a line or about an axis."""

    def __init__(self, limits: RampLimits) -> None:
        self.limits = limits
        self.x = self.y = 0.0
        """The velocity."""
        self._acceleration_x = self._acceleration_y = 0.0

    @property
    def speed(self) -> float:
        """Its length."""
        return math.hypot(self.x, self.y)

    def ahead(self, direction_x: float, direction_y: float) -> float:
        """Distance in this direction (a unit vector) before a wish to slow down has its full effect.

        The jerk limits how fast its present acceleration turns into the full deceleration. Until the acceleration is 0,
        the speed still grows by the acceleration's square over twice the jerk.
        """
        limits = self.limits
        speeding_up = max(0.0, direction_x * self._acceleration_x + direction_y * self._acceleration_y)
        lead_s = (0.5 * limits.acceleration + speeding_up) / limits.jerk + 0.5 * PERIOD_S
        gained = speeding_up * speeding_up / (2.0 * limits.jerk)
        return lead_s * (direction_x * self.x + direction_y * self.y + gained)

    def stopping(self) -> float:
        """Distance until it is at rest, if it begins to slow down smoothly after `DELAY_S`.

        An S-curve from v to rest takes v²/(2a) + v·a/(2j). Lower speeds than those that reach the full deceleration
        need less. Source: Biagiotti, Melchiorri, Trajectory Planning for Automatic Machines and Robots, 2008, section
        3.4.
        """
        speed, limits = math.hypot(self.x, self.y), self.limits
        lag_s = limits.acceleration / (2.0 * limits.jerk) + DELAY_S
        return speed * (speed / (2.0 * limits.acceleration) + lag_s)

    def keep_along(self, direction_x: float, direction_y: float, *, may_reverse: bool) -> None:
        """Keep the part along this direction (a unit vector); with `may_reverse` also the part against it."""
        speed = direction_x * self.x + direction_y * self.y
        gain = direction_x * self._acceleration_x + direction_y * self._acceleration_y
        if speed < 0.0 and not may_reverse:
            speed = gain = 0.0
        self.x, self.y = speed * direction_x, speed * direction_y
        self._acceleration_x, self._acceleration_y = gain * direction_x, gain * direction_y

    def carry(self, other: "Ramp", direction_x: float, direction_y: float) -> None:
        """Copy, as a speed along a line, another ramp's part along this direction (a unit vector)."""
        self.x, self.y = direction_x * other.x + direction_y * other.y, 0.0
        gain = direction_x * other._acceleration_x + direction_y * other._acceleration_y
        self._acceleration_x, self._acceleration_y = gain, 0.0

    def point_along(self, line: "Ramp", direction_x: float, direction_y: float) -> None:
        """Take the velocity of a speed `line` along this direction (a unit vector)."""
        self.x, self.y = line.x * direction_x, line.x * direction_y
        gain = line._acceleration_x
        self._acceleration_x, self._acceleration_y = gain * direction_x, gain * direction_y

    def stop(self) -> None:
        """Reset to rest."""
        self.x = self.y = self._acceleration_x = self._acceleration_y = 0.0

    def follow(self, wanted_x: float, wanted_y: float) -> None:
        """Advance by a period towards the wanted velocity."""
        limits = self.limits
        missing_x, missing_y = wanted_x - self.x, wanted_y - self.y
        missing = math.hypot(missing_x, missing_y)
        step = limits.jerk * PERIOD_S
        acceleration = math.hypot(self._acceleration_x, self._acceleration_y)
        if missing <= step * PERIOD_S and acceleration <= step * 1.001:
            self.x, self.y = wanted_x, wanted_y
            self._acceleration_x = self._acceleration_y = 0.0
            return
        # The greatest acceleration that can still be taken back, a step each period, until nothing is missing.
        aim = math.sqrt(0.25 * step * step + 2.0 * limits.jerk * missing) - 0.5 * step
        aim = min(limits.acceleration, aim, missing / PERIOD_S)
        share = aim / missing if missing > 0.0 else 0.0
        change_x = share * missing_x - self._acceleration_x
        change_y = share * missing_y - self._acceleration_y
        change = math.hypot(change_x, change_y)
        share = step / change if change > step else 1.0
        self._acceleration_x += share * change_x
        self._acceleration_y += share * change_y
        self.x += PERIOD_S * self._acceleration_x
        self.y += PERIOD_S * self._acceleration_y

    def brake(self, deceleration: float) -> None:
        """Advance by a period towards rest, with this deceleration and at once."""
        speed = self.speed
        left = max(0.0, speed - deceleration * PERIOD_S)
        share = left / speed if speed > 0.0 else 0.0
        self.x, self.y = share * self.x, share * self.y
        self._acceleration_x = self._acceleration_y = 0.0


def check_range(function: str, *numbers: float) -> None:
    """Raise CallError unless all numbers are in range; the types of a call are checked only if it is external."""
    for number in numbers:
        if not -METRES_MAX <= number <= METRES_MAX:
            text = f"{function}: expected finite numbers of at most {METRES_MAX:g}, got {number}"
            raise CallError(ErrorCode.BAD_ARGUMENTS, text)
