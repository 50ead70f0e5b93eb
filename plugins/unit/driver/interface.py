"""What the driver offers."""

from enum import StrEnum
from typing import Protocol

from robrain.agent.event import Event
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D


class Motion(StrEnum):
    """What the driver is at."""

    STANDING = "standing"
    DRIVING = "driving"
    BLOCKED = "blocked"
    """Something stands in the way; the driver waits in front of it."""


class DriverInterface(Protocol):
    """Motion and odometry. Everything is in the frame odom, which starts where the robot started."""

    arrived: Event[Point2D]
    """The end of the path, when it has been reached."""

    def follow(self, path: list[Point2D]) -> None:
        """Drive along these points to the last one; takes the place of what was driven before."""

    def stop(self) -> None:
        """Stand still."""

    def motion(self) -> Motion:
        """What the driver is at."""
        ...

    def blocked_s(self) -> float:
        """For how long something has stood in the way; 0 if nothing does."""
        ...

    def pose(self) -> Pose2D:
        """T_odom_robot now."""
        ...

    def pose_at(self, stamp_ns: int) -> Pose2D:
        """T_odom_robot at a time within the last second."""
        ...

    def velocity(self) -> Twist2D:
        """Velocity in the body frame."""
        ...

    def radius_m(self) -> float:
        """Radius of the round footprint."""
        ...
