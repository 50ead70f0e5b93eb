"""What is known of the other robots."""

from typing import Protocol

import msgspec

from robrain.protocol.model.geometry import Pose2D, Twist2D


class Teammate(msgspec.Struct, frozen=True):
    """Another robot, arena frame."""

    name: str
    pose: Pose2D
    velocity: Twist2D
    radius_m: float


class TeammatesInterface(Protocol):
    """The other robots."""

    def others(self) -> list[Teammate]:
        """Those heard within the last two seconds, by name."""
        ...
