"""What the driver is to do: a path with the way it is to be looked along, and how fast its corners can be taken."""

import itertools
import math

from robrain.plugins.unit.driver.ramp import speed_to_stop
from robrain.protocol.model.geometry import Point2D, Pose2D, wrap_angle_rad

CORNER_M = 0.25
"""A waypoint that is not the last counts as passed within this."""
NARROW_CORNER_M = 0.15
"""`CORNER_M` on a path through narrow places."""
TANGENT_M = 0.2
LOOK_AHEAD_M = 1.5
"""Corners farther off do not matter yet at any speed of a small robot."""


class Path:
    """Points to drive along, frame odom.

    Args:
        points: at least one; the last is the goal.
        arrived_m: the goal is reached within this.
        yaw_rad: where to look on the way; where it goes if None.
        turned_rad: the goal is reached only when it looks there to within this; however it looks if None.
        fastest_m_s: never faster than this.
        is_narrow: whether it leads through narrow places, where the robot has to squeeze.

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
    ) -> None:
        self.is_narrow = is_narrow
        self._corner_m = NARROW_CORNER_M if is_narrow else CORNER_M
        self.arrived_m = arrived_m
        self.fastest_m_s = fastest_m_s
        self.yaw_rad = yaw_rad
        self._turned_rad = turned_rad
        self._points = list(points)

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
        while len(self._points) > 1 and pose.distance_m(self._points[0]) < self._corner_m:
            self._points.pop(0)

    def is_at_goal(self, pose: Pose2D) -> bool:
        """Whether the goal's place has been reached."""
        return len(self._points) == 1 and pose.distance_m(self._points[0]) < self.arrived_m

    def is_done(self, pose: Pose2D) -> bool:
        """Whether the goal has been reached, and the robot looks where it should."""
        return self.is_at_goal(pose) and (
            self._turned_rad is None or abs(self.to_turn_rad(pose, 0.0)) < self._turned_rad
        )

    def way_left_m(self, pose: Pose2D) -> float:
        """Length of the rest of the way."""
        return pose.distance_m(self._points[0]) + sum(
            math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) for a, b in itertools.pairwise(self._points)
        )

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
        """How far to turn to look where it should, with the target at `bearing_rad` of the robot's frame."""
        return bearing_rad if self.yaw_rad is None else wrap_angle_rad(self.yaw_rad - pose.yaw_rad)

    def speed_m_s(self, pose: Pose2D, acceleration_m_s2: float, ahead_m: float, delay_s: float) -> float:
        """How fast the way ahead can be driven: to be at rest at its end, and slow enough at each corner before.

        `ahead_m` is driven before a wish to slow down has its effect, see `Ramp.ahead`.

        At a corner the velocity changes by 2·v·sin(θ/2). With the acceleration a this takes v·sin(θ/2)/a before the
        corner and as long after, thus a blend that begins d before it allows v² = a·d / sin(θ/2).
        """
        left_m = pose.distance_m(self._points[0]) - ahead_m
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
                fastest_m_s = min(fastest_m_s, through_m_s + speed_to_stop(slack_m, acceleration_m_s2, delay_s))
            left_m += math.hypot(after.x_m - corner.x_m, after.y_m - corner.y_m)
            before = corner
        return min(fastest_m_s, speed_to_stop(left_m, acceleration_m_s2, delay_s))
