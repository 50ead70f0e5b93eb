"""What localisation offers."""

from typing import Protocol

from robrain.protocol.model.geometry import Point2D, Pose2D


class LocalisationInterface(Protocol):
    """The robot's place in the team's frame."""

    def pose(self) -> Pose2D:
        """T_arena_robot now."""
        ...

    def to_odom(self, points: list[Point2D]) -> list[Point2D]:
        """Points of the arena frame in the frame odom."""
        ...
