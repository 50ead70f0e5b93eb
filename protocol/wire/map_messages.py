"""Messages of the team's map: cells of submaps, where submaps lie, and loop closures between robots."""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.mapping.map_frame import ARENA, MapFrame
from robrain.protocol.model.ranges import METRES_MAX, Count, Metres, Name, Quantity
from robrain.protocol.wire.messages import Message

Resolution = Annotated[float, Meta(ge=1e-4, le=METRES_MAX)]
Cells = Annotated[int, Meta(ge=0, le=1 << 24)]
CellIndex = Annotated[int, Meta(ge=-(1 << 16), le=1 << 16)]
Milliseconds = Annotated[int, Meta(ge=0, lt=1 << 31)]


class MapPatch(Message, frozen=True, kw_only=True):
    """Cells of a submap whose class changed by this robot's own sensing since its last patch; or where a submap lies.

    The geometry of the team's grid comes with each patch; `row`, `column`, `rows`, `columns` say which box the cells
    fill, in the frame `local` of the submap: the lattice of the team's grid, moved by `T_arena_local`. The box may
    leave the grid. Cells are int8, row-major, row 0 at the lowest y: 0 free, 100 occupied, −1 no statement; deflated
    (zlib), base64 in JSON. A patch without cells moves or withdraws a submap. `robrain.protocol.wire.map_patch` makes
    and takes them.
    """

    robot: Name
    resolution_m: Resolution
    origin_x_m: Metres
    origin_y_m: Metres
    width: Cells
    height: Cells
    row: CellIndex = 0
    column: CellIndex = 0
    rows: Cells = 0
    columns: Cells = 0
    observed_ms: Milliseconds = 0
    """When the cells were seen, by `map_stamp_ms`; of two values for a cell the later one counts."""
    cells: bytes = b""
    tiles_ms: bytes = b""
    """In a patch that tells a whole submap: when each tile of 8 × 8 cells was seen, int32, row-major, deflated."""
    surfaces: bytes = b""
    """When the submap is finished: where in their cells its walls are, `SURFACE` of `protocol/model/mapping/submap.py`,
    deflated."""
    submap: Count = 0
    """Number of the submap; a later one of the same robot has a greater number."""
    T_arena_local: Pose2D = Pose2D(0.0, 0.0, 0.0)
    """Where the submap's frame lies; the identity while it has not been corrected."""
    frame: MapFrame = ARENA
    """The map frame in which it lies there: the arena frame, or one of a robot that does not know its place."""
    variance_m2: Quantity = 0.0
    """Variance of that place in x and in y …"""
    variance_rad2: Quantity = 0.0
    """… and of its yaw."""
    withdrawn: bool = False
    """The submap is wrong: leave it out of the map."""
    parts: Annotated[tuple["MapPatch", ...], Meta(max_length=8192)] = ()
    """Further patches, also of other robots' submaps, which count where nothing else is known of these."""


class Closure(msgspec.Struct, frozen=True, kw_only=True):
    """A scan of one submap that lies on a submap of another robot: a loop closure between robots."""

    submap: Count
    """Of the robot that scanned."""
    at: Pose2D
    """T_local_sensor in the frame of that submap."""
    mate: Name
    mate_submap: Count
    at_mate: Pose2D
    """T_local_sensor in the frame of the mate's submap."""
    information: Annotated[tuple[Quantity, ...], Meta(min_length=6, max_length=6)]
    """Inverse covariance of the difference in x, y, yaw, in the axes of the mate's frame: xx, xy, xyaw, yy, yyaw,
    yawyaw."""


class Closures(Message, frozen=True, kw_only=True):
    """Loop closures that a robot has found between its submaps and those of others."""

    robot: Name
    closures: Annotated[list[Closure], Meta(max_length=256)]
