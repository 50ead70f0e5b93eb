"""What localisation offers."""

from typing import Protocol

import msgspec

from robrain.agent.event import Event
from robrain.protocol.model.geometry import Point2D, Pose2D


class Divergence(msgspec.Struct, frozen=True, kw_only=True):
    """The robot does not know any more where it is, or has found itself again."""

    is_lost: bool
    why: str
    pose: Pose2D
    """T_arena_robot as it is believed now."""
    sigma_m: float
    """Standard deviation of that place."""


class LocalisationHealth(msgspec.Struct, frozen=True, kw_only=True):
    """Quality of the estimate, and the sources that it rests on."""

    lost: str
    """Why it is not to be believed; empty while it is."""
    sigma_m: float
    sigma_rad: float
    mean_nis: float
    """Mean normalised innovation squared of the last signals of motes; about 1 or below when all is well."""
    signals: int
    """Signals of motes taken in."""
    signals_refused: int
    """Those that could not be right where the robot believed to be."""
    matches: int
    """Scans that lay on the map with walls to hold the robot."""
    last_fit: float
    """Share of the last such scan's beams that ended at the map's walls."""
    scale_error: float
    """Estimated errors of the odometry: of the way, …"""
    curve_rad_per_m: float
    """… turning that it does not see, for each metre ahead, …"""
    turn_error: float
    """… and of the turning."""


class LocalisationInterface(Protocol):
    """The robot's place in the team's frame."""

    diverged: Event[Divergence]
    """Told when the robot is lost, and again when it has been found."""

    def pose(self) -> Pose2D:
        """T_arena_robot now."""

    def to_odom(self, points: list[Point2D]) -> list[Point2D]:
        """Points of the arena frame in the frame odom."""

    def health(self) -> LocalisationHealth:
        """How much the estimate is worth."""
