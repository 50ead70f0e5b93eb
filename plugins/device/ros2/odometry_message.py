"""Checks of a nav_msgs/Odometry: finite numbers in range, and a valid orientation."""

import math
from typing import NamedTuple, Protocol

from robrain.protocol.clock import NS_PER_S
from robrain.protocol.model.geometry import Pose2D, Twist2D

PLACE_MAX_M = 1e5
"""Largest distance of a robot from its start."""
SPEED_MAX = 100.0
"""Metres or radians per second that no base can make."""
NORM_SLACK = 0.05
"""How far the length of an orientation's quaternion may be from 1."""


class BadOdometry(ValueError):
    """A message that is not believed; the text is the reason."""


class Stamp(Protocol):
    """builtin_interfaces/Time."""

    sec: int
    nanosec: int


class Header(Protocol):
    """std_msgs/Header."""

    stamp: Stamp
    frame_id: str


class Vector(Protocol):
    """geometry_msgs/Vector3 or Point."""

    x: float
    y: float
    z: float


class Quaternion(Protocol):
    """geometry_msgs/Quaternion."""

    x: float
    y: float
    z: float
    w: float


class Pose(Protocol):
    """geometry_msgs/Pose."""

    position: Vector
    orientation: Quaternion


class Twist(Protocol):
    """geometry_msgs/Twist."""

    linear: Vector
    angular: Vector


class PoseWithCovariance(Protocol):
    """geometry_msgs/PoseWithCovariance."""

    pose: Pose


class TwistWithCovariance(Protocol):
    """geometry_msgs/TwistWithCovariance."""

    twist: Twist


class OdometryMessage(Protocol):
    """nav_msgs/Odometry."""

    header: Header
    pose: PoseWithCovariance
    twist: TwistWithCovariance


class OdometryReading(NamedTuple):
    """Odometry as the robot reported it."""

    stamp_ns: int
    """Time by the publisher's clock; 0 if the message has no stamp."""
    pose: Pose2D
    """Of the body in the robot's own odometry frame."""
    velocity: Twist2D


def read_odometry(message: OdometryMessage) -> OdometryReading:
    """The planar part of a message (BadOdometry).

    The velocity is that in the body frame, as the message defines it.
    """
    place, orientation = message.pose.pose.position, message.pose.pose.orientation
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    if not (abs(place.x) <= PLACE_MAX_M and abs(place.y) <= PLACE_MAX_M):  # also False for NaN
        raise BadOdometry(f"expected a place within {PLACE_MAX_M:g} m, got {place.x:g}, {place.y:g}")
    velocity = Twist2D(linear.x, linear.y, angular.z)
    if not all(abs(each) <= SPEED_MAX for each in (linear.x, linear.y, angular.z)):
        raise BadOdometry(f"expected speeds up to {SPEED_MAX:g}, got {velocity}")
    stamp = message.header.stamp
    pose = Pose2D(place.x, place.y, yaw_of(orientation))
    return OdometryReading(stamp.sec * NS_PER_S + stamp.nanosec, pose, velocity)


def yaw_of(orientation: Quaternion) -> float:
    """Yaw (rad) of an orientation, by which the body's x axis points, seen from above (BadOdometry)."""
    x, y, z, w = orientation.x, orientation.y, orientation.z, orientation.w
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not abs(norm - 1.0) <= NORM_SLACK:
        raise BadOdometry(f"expected a quaternion of length 1, got {x:g}, {y:g}, {z:g}, {w:g}")
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
