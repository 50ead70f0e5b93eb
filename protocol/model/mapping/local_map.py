"""What a robot's localisation goes by: the robot's own recent surroundings, and where their frame lies in the arena."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.mapping.map_frame import ARENA, MapFrame
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
    """Counts how often the robot's own map was begun anew."""
    frame: MapFrame = ARENA
    """The map frame of `T_arena_local`."""
    why: str = ""
    """Why that is not the arena frame; empty if it is."""


class ArenaFix(NamedTuple):
    """How a robot's map frame lies in the arena, as found from motes."""

    T_arena_frame: Pose2D
    at: Pose2D
    """Where the robot is, in the arena."""
    covariance: NDArray[np.float64]
    """(3, 3) of that pose in x, y, yaw: m², m·rad, rad²."""
    trajectory: int
    """Of the robot when it was found."""


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
    lost: str = ""
    """Why the robot does not know its place in the arena: a trajectory that begins so has a map frame of its own."""
