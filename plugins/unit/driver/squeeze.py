"""Squeezing: how the driver passes a place that is hardly wider than the robot.

The robot follows the direction of the path, more slowly in a narrower place. It centres itself between the obstacles on
its left and right, because the map behind the path is coarser than the spare room. It never comes nearer than `KEEP_M`
to anything the lidar sees.
"""

import math
from typing import NamedTuple

from robrain.algorithms.navigation.clearance import LEAST_MARGIN_M, PREFERRED_MARGIN_M, least_clearance_m, least_gap_m
from robrain.algorithms.navigation.obstacles import Passage
from robrain.plugins.unit.obstacle_distance import Lookout
from robrain.protocol.model.geometry import Pose2D, wrap_angle_rad

BEGIN_M = 0.3
"""The driver squeezes where normal driving has less room ahead than this."""
SPEED_M_S, WIDE_M_S = 0.15, 0.6
"""Speed at the least clearance and at the preferred one; it grows linearly between them."""
CREEP_M_S = 0.05
"""Least speed between walls, regardless of apparent obstacles ahead: `hold_off` lets the robot slide along walls."""
CENTRING_PER_S = 1.5
CENTRING_M_S = 0.08
SEEN_M = 0.1
"""Walls farther than this from the hull do not count for centring."""
OFF_CENTRE_M = 0.04
"""This far off the middle the robot only creeps ahead."""
BEND_RAD = math.radians(30.0)
"""The robot does not centre itself where the path bends by more than this."""
TOLERANCE_M = 0.005
"""A gap that seems at most this much wider than the robot is not entered."""
ASIDE_RAD = tuple(math.radians(degrees) for degrees in (10.0, -10.0, 20.0, -20.0))
"""Seen at an angle a gap seems narrower than it is. Where the path is not parallel to the walls, one of these is."""
KEEP_M = 0.01
KEEP_PER_S = 1.5


class Squeeze(NamedTuple):
    """Motion in a narrow place."""

    heading_rad: float
    """Direction, frame odom."""
    speed_m_s: float
    """Highest speed in that direction."""
    left_m_s: float
    """Speed to the left of that direction, towards the middle."""
    free_m: float
    """The room ahead."""
    is_between: bool
    """Whether the robot is between walls, or about to be."""
    gap_m: float | None
    """Width between them if the robot does not fit; otherwise None."""

    def velocity_m_s(self, forward_m_s: float) -> tuple[float, float]:
        """Velocity (x, y), frame odom, with `forward_m_s` in the direction `heading_rad`."""
        cos, sin = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return forward_m_s * cos - self.left_m_s * sin, forward_m_s * sin + self.left_m_s * cos


def squeeze(lookout: Lookout, pose: Pose2D, target_rad: float, along_rad: float, radius_m: float) -> Squeeze:
    """Motion where there is little room.

    Between walls the robot drives parallel to the path, `along_rad`, because the path may be off the middle by half a
    cell of the map. Before the walls, and where the path bends, it drives towards the path, `target_rad`. Both angles
    are in the frame odom.
    """
    seen_m = radius_m + SEEN_M
    along = lookout.passage(pose, along_rad)
    spare_m = 0.5 * (along.left_m + along.right_m) - least_clearance_m(radius_m)
    share = max(0.0, min(1.0, spare_m / (PREFERRED_MARGIN_M - LEAST_MARGIN_M)))
    speed_m_s = SPEED_M_S + share * (WIDE_M_S - SPEED_M_S)
    gap_m = along.left_m + along.right_m
    reported_gap_m = gap_m if gap_m < least_gap_m(radius_m) else None
    bends = abs(wrap_angle_rad(target_rad - along_rad)) > BEND_RAD
    if bends or max(along.left_m, along.right_m) > seen_m:
        free_m = lookout.passage(pose, target_rad).free_m
        return Squeeze(target_rad, SPEED_M_S if bends else speed_m_s, 0.0, free_m, share < 1.0, reported_gap_m)
    off_m = _off_centre_m(along, seen_m)
    left_m_s = max(-CENTRING_M_S, min(CENTRING_M_S, CENTRING_PER_S * off_m))
    if _is_shut(along, radius_m) and all(
        _is_shut(lookout.passage(pose, along_rad + aside_rad), radius_m) for aside_rad in ASIDE_RAD
    ):
        return Squeeze(along_rad, 0.0, left_m_s, 0.0, True, gap_m)
    speed_m_s = max(CREEP_M_S, speed_m_s * (1.0 - abs(off_m) / OFF_CENTRE_M))
    return Squeeze(along_rad, speed_m_s, left_m_s, along.free_m, share < 1.0, reported_gap_m)


def is_between(lookout: Lookout, pose: Pose2D, along_rad: float, radius_m: float) -> bool:
    """Whether the walls on both sides of the path leave less than the preferred clearance."""
    found = lookout.passage(pose, along_rad)
    return found.left_m + found.right_m < 2.0 * (radius_m + PREFERRED_MARGIN_M)


def _is_shut(found: Passage, radius_m: float) -> bool:
    """Whether a passage seems no wider than the robot.

    Walls are measured by their nearest points, so the noise of the lidar makes both seem too near. A passage that seems
    as wide as the robot therefore counts as wide enough.
    """
    return found.left_m + found.right_m < 2.0 * radius_m + TOLERANCE_M


def _off_centre_m(found: Passage, seen_m: float) -> float:
    """How far to the left the middle of a passage lies; a wall beyond `seen_m` counts as being at `seen_m`."""
    return 0.5 * (min(found.left_m, seen_m) - min(found.right_m, seen_m))
