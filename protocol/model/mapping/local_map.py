"""What a robot's localisation goes by: the robot's own recent surroundings, and where their frame lies in the arena."""

from typing import NamedTuple

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.occupancy_grid import OccupancyGrid

Variances = tuple[float, float, float]
"""Of x, y (m²) and yaw (rad²)."""
NONE: Variances = (0.0, 0.0, 0.0)
Drift = tuple[float, float]
"""Variances of place (m², for either axis) and yaw (rad²) of a robot's own map against where it began."""
NO_DRIFT: Drift = (0.0, 0.0)


class LocalMap(NamedTuple):
    """The robot's own recent map, without what others told.

    In the frame `local` the robot's estimate is continuous: it follows odometry and the recent walls. Loop closures
    correct where that frame lies in the arena.
    """

    grid: OccupancyGrid
    """With surfaces, in the frame `local`; to be read only."""
    T_arena_local: Pose2D
    anchor: Pose2D
    """The robot's place in the frame `local` when the current submap began."""
    variances: Variances
    """How unsure `T_arena_local` is at the anchor."""
    drift: Drift
    """`LocalPose.drift` when the current submap began."""
    number: int
    """Of the current submap."""
    oldest: int
    """Of the submap that the oldest cells of the grid are of."""
    trajectory: int
    """Counts how often the robot was lost and found: each time its map begins anew."""


class LocalPose(NamedTuple):
    """Where the robot's odometry frame lies in the frame `local`."""

    T_local_odom: Pose2D
    trajectory: int
    drift: Drift
    """How unsure the robot's pose is against where its own map began: walls that it sees first now keep this."""
    until_ns: int
    """Stamp of the last scan that was laid on the local map, or was left out: scans until then can be mapped."""
    fits: bool
    """Whether the last scan that was laid on the local map lies well there; if not, nothing is to be drawn."""
    sigma_m: float
    """Standard deviation of the robot's place on its own map; where that map lies in the arena may be less sure."""
