"""Squeezing: how the driver goes through a place that is hardly wider than the robot.

It goes on along the path, the slower the narrower it is, and keeps to the middle between what it sees on its left and
on its right: the map that the path was planned on is coarser than the room that there is. Whatever it wants, it comes
no nearer to anything that the lidar sees than `KEEP_M`.
"""

import math
from typing import NamedTuple

from robrain.plugins.unit.driver.lookout import Lookout
from robrain.protocol.model.clearance import (
    LEAST_MARGIN_M,
    PREFERRED_MARGIN_M,
    least_clearance_m,
    least_gap_m,
)
from robrain.protocol.model.geometry import Pose2D, wrap_angle_rad
from robrain.protocol.model.obstacles import Passage

BEGIN_M = 0.3
"""The driver squeezes where there is less room ahead than this for driving as usual."""
SPEED_M_S, WIDE_M_S = 0.15, 0.6
"""The speed in the narrowest place, and in one of the preferred clearance; between them it grows with the clearance."""
CREEP_M_S = 0.05
"""Between walls it goes on so fast, whatever seems to be ahead: it slides along what it does not run into."""
CENTRING_PER_S = 1.5
CENTRING_M_S = 0.08
SEEN_M = 0.1
"""What stands farther than this from the hull is kept away from no more."""
OFF_CENTRE_M = 0.04
"""So far off the middle the robot only creeps ahead."""
BEND_RAD = math.radians(30.0)
"""Where the path bends by more than this there is no middle to keep to."""
TOLERANCE_M = 0.005
"""What is seen to be so little wider than the robot, or less, is not entered."""
ASIDE_RAD = tuple(math.radians(degrees) for degrees in (10.0, -10.0, 20.0, -20.0))
"""Aslant a gap seems narrower than it is: where the path is not parallel to the walls, one of these is."""
KEEP_M = 0.01
KEEP_PER_S = 1.5
MOVED_M = 0.05
STUCK_NS = 3_000_000_000
"""A robot that has not moved by `MOVED_M` for so long does not get through: creeping takes a third of it."""


class Squeeze(NamedTuple):
    """What to do in a narrow place."""

    heading_rad: float
    """Where to go, frame odom."""
    speed_m_s: float
    """How fast, at the most."""
    left_m_s: float
    """How fast to the left of that, towards the middle."""
    free_m: float
    """The room ahead."""
    is_between: bool
    """The robot is between walls, or about to be."""
    gap_m: float | None
    """How wide it is between them, if that is too narrow."""

    def velocity_m_s(self, forward_m_s: float) -> tuple[float, float]:
        """Velocity (x, y), frame odom."""
        cos, sin = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return forward_m_s * cos - self.left_m_s * sin, forward_m_s * sin + self.left_m_s * cos


class Progress:
    """Whether the robot gets on in a narrow place."""

    def __init__(self) -> None:
        self._from: Pose2D | None = None
        self._since_ns = 0

    def forget(self) -> None:
        """It is in none, or on another path."""
        self._from = None

    def is_stuck(self, pose: Pose2D, now_ns: int) -> bool:
        """Whether it has not moved for `STUCK_NS`, given where it is now."""
        if self._from is None or pose.distance_m(self._from) > MOVED_M:
            self._from, self._since_ns = pose, now_ns
        return now_ns - self._since_ns > STUCK_NS


def squeeze(lookout: Lookout, pose: Pose2D, target_rad: float, along_rad: float, radius_m: float) -> Squeeze:
    """How to go on where there is little room.

    Between walls the robot goes the way that the path goes, `along_rad`, for the path itself may be off the middle by
    half of a cell of the map; before it has come so far, and where the path bends, towards the path, `target_rad`
    (frame odom).
    """
    seen_m = radius_m + SEEN_M
    along = lookout.passage(pose, along_rad)
    spare_m = 0.5 * (along.left_m + along.right_m) - least_clearance_m(radius_m)
    share = max(0.0, min(1.0, spare_m / (PREFERRED_MARGIN_M - LEAST_MARGIN_M)))
    speed_m_s = SPEED_M_S + share * (WIDE_M_S - SPEED_M_S)
    gap_m = along.left_m + along.right_m
    told_gap_m = gap_m if gap_m < least_gap_m(radius_m) else None
    bends = abs(wrap_angle_rad(target_rad - along_rad)) > BEND_RAD
    if bends or max(along.left_m, along.right_m) > seen_m:
        free_m = lookout.passage(pose, target_rad).free_m
        return Squeeze(target_rad, SPEED_M_S if bends else speed_m_s, 0.0, free_m, share < 1.0, told_gap_m)
    off_m = _off_centre_m(along, seen_m)
    left_m_s = max(-CENTRING_M_S, min(CENTRING_M_S, CENTRING_PER_S * off_m))
    if _is_shut(along, radius_m) and all(
        _is_shut(lookout.passage(pose, along_rad + aside_rad), radius_m) for aside_rad in ASIDE_RAD
    ):
        return Squeeze(along_rad, 0.0, left_m_s, 0.0, True, gap_m)
    speed_m_s = max(CREEP_M_S, speed_m_s * (1.0 - abs(off_m) / OFF_CENTRE_M))
    return Squeeze(along_rad, speed_m_s, left_m_s, along.free_m, share < 1.0, told_gap_m)


def is_between(lookout: Lookout, pose: Pose2D, along_rad: float, radius_m: float) -> bool:
    """Whether there are walls on both sides of the way nearer than the robot prefers."""
    found = lookout.passage(pose, along_rad)
    return found.left_m + found.right_m < 2.0 * (radius_m + PREFERRED_MARGIN_M)


def _is_shut(found: Passage, radius_m: float) -> bool:
    """Whether a passage seems no wider than the robot.

    Seen by their nearer points, both walls seem nearer than they are by the noise of the lidar; so what seems as wide
    as the robot passes for wide enough.
    """
    return found.left_m + found.right_m < 2.0 * radius_m + TOLERANCE_M


def _off_centre_m(found: Passage, seen_m: float) -> float:
    """How far to the left the middle of a passage lies; what is farther than `seen_m` counts as there."""
    return 0.5 * (min(found.left_m, seen_m) - min(found.right_m, seen_m))
