"""What a robot's localisation goes by: the robot's own recent surroundings, and where their frame lies in the arena."""

from typing import NamedTuple

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.occupancy_grid import OccupancyGrid

Variances = tuple[float, float, float]
"""Of x, y (m²) and yaw (rad²)."""


class LocalMap(NamedTuple):
    """The robot's own recent map, without what others told.

    In the frame `local` the robot's estimate is continuous: it follows odometry and the recent walls. What loop closures
    correct is where that frame lies in the arena.
    """

    grid: OccupancyGrid
    """In the frame `local`; to be read only."""
    T_arena_local: Pose2D
    variances: Variances
    """How unsure that is at the robot's place."""
    trajectory: int
    """Counts how often the robot was lost and found: each time its map begins anew."""


class LocalPose(NamedTuple):
    """Where the robot's odometry frame lies in the frame `local`."""

    T_local_odom: Pose2D
    trajectory: int
    until_ns: int
    """Stamp of the last scan that was laid on the local map, or was left out: scans until then can be mapped."""
