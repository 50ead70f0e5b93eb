"""What is known of the other robots."""

import math
from enum import StrEnum
from typing import Protocol

import msgspec

from robrain.algorithms.navigation.right_of_way import Track
from robrain.protocol.model.claim import Claim, Rank
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.model.map_frame import MapFrame


class Teammate(msgspec.Struct, frozen=True):
    """Another robot, in the map frame of the one that asks."""

    name: str
    pose: Pose2D
    velocity: Twist2D
    radius_m: float


class Doing(StrEnum):
    """What is to be expected of a mate."""

    UNDER_WAY = "under way"
    """It follows its path, or waits on it for others."""
    STANDING = "standing"
    """It has no path, and may be given one at any time."""
    OBSTACLE = "obstacle"
    """It is halted, silent, does not know where it is, or does not move although nobody holds it up: it is taken to
    stay where it was seen last."""


class Mate(msgspec.Struct, frozen=True, eq=False):
    """Another robot as one that drives has to reckon with it."""

    name: str
    pose: Pose2D
    radius_m: float
    """Larger than it is for one that does not know where it is."""
    doing: Doing
    claim: Claim
    track: Track
    """Its way still to go; its `keep_m` is this mate's radius alone, and `goes_first` is for the asker to fill in."""
    task: str
    """The id of the task that it is at; empty if none."""
    bound: Point2D
    """Where its path ends; where it is if it has none."""
    behavior: str = ""
    """What drives it."""
    endurance_s: float = math.inf
    """For how long its battery surely lasts at what it usually draws; inf if it does not say."""
    rank: Rank | None = None
    """`claim.rank(name)`, if it has been computed."""


class TeammatesInterface(Protocol):
    """The other robots. Those whose poses are told in another map frame than this robot's are nowhere to it."""

    def others(self) -> list[Teammate]:
        """Those heard within the last two seconds, by name, in the robot's map frame."""

    def in_frame(self, frame: MapFrame) -> list[Teammate]:
        """Those heard within the last two seconds that tell their poses in a map frame, by name."""

    def count(self) -> int:
        """How many were heard within the last two seconds, in whichever map frame."""

    def mates(self, place: Point2D, within_m: float) -> list[Mate]:
        """Those that are, or are bound, within a distance of a place, by name; also those that have fallen silent."""
