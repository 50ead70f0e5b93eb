"""Poses, twists and frames in the plane.

Frames and units follow REP 103 and REP 105: x forward, y left, yaw counter-clockwise from x; metres, radians,
seconds. The frame shared by a team is `arena` (a REP 105 `map`). `T_a_b` takes coordinates in b to coordinates
in a.
"""

import math
from collections.abc import Sequence

import msgspec

from robrain.protocol.model.ranges import Metres, Radians, Speed


class Point2D(msgspec.Struct, frozen=True):
    """A point, metres, arena frame unless stated otherwise."""

    x_m: Metres
    y_m: Metres

    def distance_m(self, other: "Pose2D | Point2D") -> float:
        """Euclidean distance between the two places."""
        return math.hypot(self.x_m - other.x_m, self.y_m - other.y_m)


def point_along(start: Point2D, path: Sequence[Point2D], length_m: float) -> Point2D | None:
    """The point after this length of the path from `start` over the corners of `path`; None if the path is shorter.

    >>> point_along(Point2D(0.0, 0.0), [Point2D(1.0, 0.0), Point2D(1.0, 4.0)], 2.0)
    Point2D(x_m=1.0, y_m=1.0)
    """
    for corner in path:
        leg_m = corner.distance_m(start)
        if leg_m >= length_m:
            share = max(0.0, length_m) / max(leg_m, 1e-9)
            return Point2D(start.x_m + share * (corner.x_m - start.x_m), start.y_m + share * (corner.y_m - start.y_m))
        start, length_m = corner, length_m - leg_m
    return None


class Pose2D(msgspec.Struct, frozen=True):
    """Position and heading: metres and radians, arena frame unless stated otherwise."""

    x_m: Metres
    y_m: Metres
    yaw_rad: Radians

    def compose(self, other: "Pose2D") -> "Pose2D":
        """T_a_b · T_b_c = T_a_c, with yaw wrapped to (−π, π]."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        yaw_rad = self.yaw_rad + other.yaw_rad
        return Pose2D(
            self.x_m + cos * other.x_m - sin * other.y_m,
            self.y_m + sin * other.x_m + cos * other.y_m,
            yaw_rad if -math.pi < yaw_rad <= math.pi else wrap_angle_rad(yaw_rad),
        )

    def inverse(self) -> "Pose2D":
        """T_a_b ⁻¹ = T_b_a."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        yaw_rad = -self.yaw_rad if -math.pi < -self.yaw_rad <= math.pi else wrap_angle_rad(-self.yaw_rad)
        return Pose2D(-cos * self.x_m - sin * self.y_m, sin * self.x_m - cos * self.y_m, yaw_rad)

    def distance_m(self, other: "Pose2D | Point2D") -> float:
        """Euclidean distance between the two places."""
        return math.hypot(self.x_m - other.x_m, self.y_m - other.y_m)


class Twist2D(msgspec.Struct, frozen=True):
    """Velocity in the body frame: forward, left, counter-clockwise."""

    forward_m_s: Speed = 0.0
    """Along the x axis of the body."""
    left_m_s: Speed = 0.0
    """Along the y axis of the body."""
    yaw_rad_s: Speed = 0.0
    """Counter-clockwise."""


def wrap_angle_rad(angle_rad: float) -> float:
    """The same direction in (−π, π].

    >>> round(wrap_angle_rad(3 * math.pi / 2), 6)
    -1.570796
    """
    if -math.pi < angle_rad <= math.pi:
        return angle_rad
    wrapped = math.fmod(angle_rad + math.pi, 2 * math.pi)
    if wrapped <= 0:
        wrapped += 2 * math.pi
    return wrapped - math.pi


IDENTITY = Pose2D(0.0, 0.0, 0.0)
"""The transform that changes nothing."""
