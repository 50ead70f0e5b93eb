"""Messages of the team's map: cells and poses of submaps, and loop closures between robots."""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.messages.message import Message, SharedMessage
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.map_frame import ARENA, MapFrame
from robrain.protocol.model.ranges import METRES_MAX, Count, Metres, Name, Quantity

Resolution = Annotated[float, Meta(ge=1e-4, le=METRES_MAX)]
Cells = Annotated[int, Meta(ge=0, le=1 << 24)]
CellIndex = Annotated[int, Meta(ge=-(1 << 16), le=1 << 16)]
Milliseconds = Annotated[int, Meta(ge=0, lt=1 << 31)]


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
