"""The map that localisation matches scans against: the robot's recent surroundings, and the pose of their frame."""

from collections.abc import Callable
from typing import NamedTuple

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.map_frame import ARENA, MapFrame

Variances = tuple[float, float, float]
"""Variances of x, y (m²) and yaw (rad²)."""
NONE: Variances = (0.0, 0.0, 0.0)
Drift = tuple[float, float]
"""Variances of position (m² per axis) and yaw (rad²) of the robot's own map, relative to its first pose."""
NO_DRIFT: Drift = (0.0, 0.0)


class LocalMap(NamedTuple):
    """The robot's own recent map, without the maps of other robots.

    In the frame `local` the pose estimate is continuous: it follows odometry and the recent walls. Loop closures change
    only `T_arena_local`, the pose of this frame in the arena.
    """

    grid: OccupancyGrid
    """The map in the frame `local`, with surfaces; read-only."""
    T_arena_local: Pose2D
    anchor: Pose2D
    """Pose of the robot in the frame `local` when the current submap began."""
    variances: Variances
    """Variances of `T_arena_local` at the anchor."""
    drift: Drift
    """`LocalPose.drift` when the current submap began."""
    number: int
    """Number of the current submap."""
    oldest: int
    """Number of the submap to which the oldest cells of the grid belong."""
    trajectory: int
    """Number of times that the robot's own map was started again."""
    frame: MapFrame = ARENA
    """The map frame of `T_arena_local`."""
    reason: str = ""
    """Reason why this is not the arena frame; empty if it is."""
    with_yaw: tuple[float, float] = (0.0, 0.0)
    """Covariances of x and y with yaw (m·rad) of `T_arena_local` at the anchor."""


class ArenaFix(NamedTuple):
    """Pose of a robot's map frame in the arena, as found from motes."""

    T_arena_frame: Pose2D
    at: Pose2D
    """Pose of the robot in the arena."""
    covariance: Floats
    """(3, 3) of that pose in x, y, yaw: m², m·rad, rad²."""
    trajectory: int
    """Of the robot when it was found."""


class LocalPose(NamedTuple):
    """Pose of the odometry frame in the frame `local`."""

    T_local_odom: Pose2D
    trajectory: int
    drift: Drift
    """Variances of the robot's pose relative to where its own map began; stored with walls that it now sees first."""
    until_ns: int
    """Stamp of the last scan that was matched or skipped; scans up to it can be mapped."""
    fits: bool
    """Whether the last scan matched the local map; if not, scans must not be mapped."""
    sigma_m: float
    """Standard deviation of the robot's place on its own map; the place of that map in the arena may be less certain.
    """
    lost: str = ""
    """Reason why the robot does not know its place in the arena. A trajectory that begins with a reason has its own map
    frame."""
    checked: tuple[int, ...] | None = None
    """Stamps of the last scans that were matched; only these may be mapped. None if none has to be matched."""


class OwnMap:
    """The robot's own map, shared by localisation and the mapper; no other plugin writes to it."""

    def __init__(self) -> None:
        self.local_map: LocalMap | None = None
        """The map against which scans are matched; the mapper writes it."""
        self.robot_places: Floats | None = None
        """(K, 3) published places and radii of other robots: x, y, radius in metres, robot's map frame; by the
        mapper."""
        self.map_of_others: OccupancyGrid | None = None
        """The map that the others had when this robot came, for some seconds after it; the mapper writes it."""
        self.misplaced = ""
        """Reason why the map lies wrong and a new one must begin; the mapper writes it, localisation empties it."""
        self.local_pose: LocalPose | None = None
        """Pose of the odometry frame in the frame of that map; localisation writes it."""
        self.arena_fix: ArenaFix | None = None
        """Pose of the robot's map frame in the arena, by motes; localisation writes it, the mapper removes it."""
        self.may_be_at: Callable[[Pose2D], bool] = lambda _pose: True
        """Whether motes' signals allow the robot to be at a pose of the arena frame; localisation writes it."""
        self.false_start = False
        """Whether the robot did not start at its configured pose; localisation writes it."""
