"""What a gateway to ROS 2 shows of a team, and what it takes from there; how it speaks is the publisher's matter.

A publisher speaks rclpy (`RclpyPublisher`) or whatever reaches ROS 2 nodes. Poses and paths are in the team's frame.
"""

import re
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.wire.messages.team.arena_messages import Scan

_NOT_IN_NAMES = re.compile(r"[^A-Za-z0-9_]")


class ShownMap(NamedTuple):
    """A map as nav_msgs/OccupancyGrid has it."""

    cells: NDArray[np.int8]
    """(H, W): −1 unknown, 0 free, 100 occupied; row 0 is the lowest."""
    resolution_m: float
    origin_x_m: float
    """Of the lower left corner."""
    origin_y_m: float
    stamp_ns: int


class TeamPublisher(Protocol):
    """Says to ROS 2 what it is told. Every function returns at once; times are ns since 1970."""

    def show_map(self, shown: ShownMap) -> None:
        """The team's map."""

    def show_pose(self, robot: str, pose: Pose2D, stamp_ns: int) -> None:
        """Where a robot is."""

    def show_path(self, robot: str, points: list[Point2D], stamp_ns: int) -> None:
        """Where it means to go; empty if it stands."""

    def show_scan(self, scan: Scan) -> None:
        """A turn of its lidar."""

    def tell_event(self, text: str) -> None:
        """A change of a task, as JSON."""


class Answer(NamedTuple):
    """What became of an order."""

    accepted: bool
    text: str
    """The task as JSON, the robots that have stopped, or why not."""


class Orders(NamedTuple):
    """What ROS 2 may ask of the team. Each waits for the team's answer, for some seconds at most, and never raises."""

    submit: Callable[[str], Answer]
    """Submit a task, given as JSON."""
    halt: Callable[[], Answer]
    """Halt all robots."""


def ros_name(name: str) -> str:
    """A robot's name as a part of the names of ROS topics and frames.

    >>> ros_name("r-1.b"), ros_name("7")
    ('r_1_b', '_7')
    """
    changed = _NOT_IN_NAMES.sub("_", name)
    return f"_{changed}" if changed[:1].isdigit() else changed
