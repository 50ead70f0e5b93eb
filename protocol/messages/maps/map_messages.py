"""Messages of the team's map: cells and poses of submaps, loop closures between robots, regions left to explore."""

from enum import StrEnum
from types import NoneType
from typing import Annotated, cast

import msgspec
from msgspec import Meta

from robrain.protocol.messages.message import Message, SharedMessage
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.map_frame import ARENA, MapFrame
from robrain.protocol.model.ranges import METRES_MAX, Count, Length, Metres, Name, Quantity
from robrain.protocol.topic import Delivery, Query, Topic, Urgency

Resolution = Annotated[float, Meta(ge=1e-4, le=METRES_MAX)]
Cells = Annotated[int, Meta(ge=0, le=1 << 24)]
CellIndex = Annotated[int, Meta(ge=-(1 << 16), le=1 << 16)]
Milliseconds = Annotated[int, Meta(ge=0, lt=1 << 31)]
FLOOR = "floor"
"""Name, in place of a robot's, under which the coordinator publishes a floor that was known before the run."""


class MapPatch(SharedMessage, frozen=True, kw_only=True):
    """Cells of a submap whose class this robot's sensing has changed since its last patch, or the pose of a submap.

    Each patch carries the geometry of the team's grid. The cells fill the box given by `row`, `column`, `rows` and
    `columns`, in the frame `local` of the submap. They are the cells of the team's grid, moved by `T_arena_local`. The
    box may extend beyond the grid. Cells are int8, row-major, row 0 at the lowest y: 0 free, 100 occupied, −1 no
    statement; deflated (zlib), base64 in JSON. A patch without cells moves, finishes or withdraws a submap.
    `robrain.algorithms.slam.map_patch` makes and merges patches.
    """

    robot: Name
    resolution_m: Resolution
    """Edge of a cell of the team's grid."""
    origin_x_m: Metres
    """Lower left corner of the team's grid, arena frame."""
    origin_y_m: Metres
    """Lower left corner of the team's grid, arena frame."""
    width: Cells
    """Columns of the team's grid."""
    height: Cells
    """Rows of the team's grid."""
    row: CellIndex = 0
    """First row of the box."""
    column: CellIndex = 0
    """First column of the box."""
    rows: Cells = 0
    """Height of the box in cells."""
    columns: Cells = 0
    """Width of the box in cells."""
    observed_ms: Milliseconds = 0
    """Time of observation of the cells, by `map_stamp_ms`; of two values for a cell the later one wins."""
    cells: bytes = b""
    """The cells of the box, int8, row-major, deflated."""
    tiles_ms: bytes = b""
    """Time of observation of each tile of 8 × 8 cells in a patch of a whole submap: int32, row-major, deflated."""
    surfaces: bytes = b""
    """Places of the walls within their cells, sent when a submap is finished: `SURFACE` of
    `algorithms/slam/submap.py`, deflated."""
    submap: Count = 0
    """Number of the submap; numbers of one robot increase."""
    T_arena_local: Pose2D = Pose2D(0.0, 0.0, 0.0)
    """Pose of the submap's frame; the identity until it is corrected."""
    frame: MapFrame = ARENA
    """The map frame of that pose: the arena frame, or one of a robot that does not know its place."""
    variance_m2: Quantity = 0.0
    """Variance of that pose in x and in y, m²; 0 if unknown."""
    variance_rad2: Quantity = 0.0
    """Variance of that pose in yaw, rad²; 0 if unknown."""
    withdrawn: bool = False
    """Whether the submap is wrong and must be removed from the map."""
    parts: Annotated[tuple["MapPatch", ...], Meta(max_length=8192)] = ()
    """Further patches. Those of other robots' submaps are used only if the receiver does not know these submaps."""


class Closure(msgspec.Struct, frozen=True, kw_only=True):
    """A loop closure between robots: a scan of one robot that matches a submap of another."""

    submap: Count
    """Number of the submap of the robot that scanned."""
    at: Pose2D
    """Pose of the sensor in the frame of that submap."""
    other_robot: Name
    """Name of the other robot."""
    other_submap: Count
    """Number of the submap of the other robot."""
    at_other: Pose2D
    """Pose of the sensor in the frame of that submap."""
    information: Annotated[tuple[Quantity, ...], Meta(min_length=6, max_length=6)]
    """Inverse covariance of the match in x, y and yaw, in the axes of the teammate's submap. The values are the upper
    triangle xx, xy, xyaw, yy, yyaw, yawyaw, in 1/m², 1/(m·rad) and 1/rad²."""


class Closures(Message, frozen=True, kw_only=True):
    """Loop closures that a robot has found between its own submaps and those of others."""

    robot: Name
    closures: Annotated[list[Closure], Meta(max_length=256)]
    """Matches found since the last message."""


ROBOT_MAP = Topic(
    "robot/{robot}/map", "Cells of a submap that the robot's own sensing changed, and poses of its submaps", MapPatch,
    rate_hz=2, delivery=Delivery.LOSSLESS, cache=256, urgency=Urgency.DATA_LOW, recorded=True,
    max_bytes=16_777_216)  # fmt: skip
ROBOT_MAP_WHOLE = Query(
    "robot/{robot}/map/whole", "The robot's whole map, for late subscribers", NoneType, cast("type[MapPatch | None]",
    MapPatch | None), urgency=Urgency.BACKGROUND, reads_only=True)  # fmt: skip
ROBOT_CLOSURES = Topic(
    "robot/{robot}/closures", "Loop closures between the robot's scans and submaps of others", Closures,
    delivery=Delivery.LOSSLESS, urgency=Urgency.DATA_LOW, recorded=True)  # fmt: skip


REGIONS_MAX = 64
"""Regions named one by one; of smaller ones only number and area are published."""
Area = Annotated[float, Meta(ge=0.0, le=1e12)]
"""Square metres."""


class LeftKind(StrEnum):
    """Why a region is left."""

    TOO_NARROW = "too_narrow"
    """It has been seen, but the widest path there has a gap too narrow for the robots."""
    UNREACHABLE = "unreachable"
    """It has been seen, but the map shows no path there at all: it lies behind glass or a fence."""
    TRIED = "tried"
    """Robots were sent there and failed repeatedly."""
    CUT_OFF = "cut_off"
    """An obstacle blocks a path that robots have used before, such as a closed door."""
    UNSEEN = "unseen"
    """Robots have a path to its edge and were not sent there: time or energy ran out."""


class RegionLeft(msgspec.Struct, frozen=True, kw_only=True):
    """One region, arena frame."""

    kind: LeftKind
    place: Point2D
    """A point of it: for `unseen` and `tried` at its edge, where robots can look in; else the one farthest from its
    edge."""
    area_m2: Area
    """Area of its floor that has been seen. Where robots can look in, an estimate: the unknown area within 2 m of its
    edge that no known wall hides."""
    low: Point2D
    """Corner of its bounding box with the least x and y."""
    high: Point2D
    """Corner of its bounding box with the greatest x and y."""
    gap_m: Length | None = None
    """`too_narrow`: width of the gap; as a robot measured it, else as on the map, to within one cell of the map.
    `unseen`: the same, if the path there is narrower than robots prefer and may prove too narrow."""
    needed_m: Length | None = None
    """Width of the narrowest gap that the robots drive through; None if `gap_m` is."""
    gap_at: Point2D | None = None
    """`too_narrow`: where a robot stood in front of the gap; None if no robot has measured it."""
    tries: Count = 0
    """Number of failures of robots to get there."""

    @property
    def words(self) -> str:
        """Why it is left, for people."""
        by = "measured" if self.gap_at is not None else "on the map"
        gap = f"the gap is {self.gap_m or 0.0:.2f} m wide ({by}), robots need {self.needed_m or 0.0:.2f} m"
        match self.kind:
            case LeftKind.TOO_NARROW:
                return gap
            case LeftKind.UNREACHABLE:
                return "seen, but there is no way there"
            case LeftKind.TRIED:
                return f"robots failed to get there {self.tries} times"
            case LeftKind.CUT_OFF:
                return "was reachable before, the way is blocked now"
            case LeftKind.UNSEEN:
                return "can be reached, has not been seen" if self.gap_m is None else f"not seen; {gap}"


class ExplorationLeft(Message, frozen=True, kw_only=True):
    """All regions that exploration has not covered, by the team's map."""

    regions: Annotated[list[RegionLeft], Meta(max_length=REGIONS_MAX)] = msgspec.field(default_factory=list)
    """Largest first."""
    more: Count = 0
    """Number of regions that are smaller than these."""
    more_m2: Area = 0.0
    """Area of those."""


COORDINATOR_LEFT = Topic(
    "coordinator/left", "Unexplored places with reasons, at the end of exploration and on later changes",
    ExplorationLeft, delivery=Delivery.LOSSLESS, urgency=Urgency.DATA_LOW, recorded=True)  # fmt: skip
COORDINATOR_LEFT_NOW = Query(
    "coordinator/left/now", "Unexplored places now: replies an `ExplorationLeft`, or null before the first map",
    NoneType, cast("type[ExplorationLeft | None]", ExplorationLeft | None), reads_only=True)  # fmt: skip
