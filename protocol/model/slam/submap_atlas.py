"""The team's map, composed of submaps that can be moved or withdrawn later.

Where submaps overlap, the cell observed last wins; at equal times an occupied cell wins: the rule of
`OccupancyGrid.merge_patch`. While no submap has been moved, the composition equals all patches merged into one grid. A
submap that moves is erased at its old pose and drawn at the new one, by nearest-neighbour lookup.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.mapping.map_frame import ARENA, MapFrame
from robrain.protocol.model.mapping.occupancy_grid import LAST_STAMP_MS, GridGeometry, OccupancyGrid
from robrain.protocol.model.numeric.kernel_array import INT8, kernel_array
from robrain.protocol.model.slam.submap import IDENTITY, TILE_CELLS, Submap, Told, moved_box
from robrain.protocol.model.slam.submap_drawing_kernels import Box, draw, take_and_draw

SUBMAPS_MAX = 8192
"""Largest number of submaps of an atlas; further ones are refused."""
CELLS_MAX = 1 << 27
"""Limit for the bytes of all submaps: one for each cell, 11 for each surface. What needs more is refused."""

SubmapKey = tuple[str, int]
"""Name of a robot and number of its submap."""
ALL = Told(0, 0, np.empty((0, 0), np.bool_))
"""All tiles of a submap."""


class _Placed(NamedTuple):
    """Where the cells of a submap lie in the grid, and what that was computed from."""

    at: Pose2D
    row: int
    column: int
    motion: tuple[float, float, float, float]
    """cos, sin, x and y of `at`."""
    lookup: tuple[float, float, float, float]


class SubmapAtlas:
    """Submaps of a team, composed into one grid.

    Args:
        geometry: the team's grid. Cells outside it are kept, but not drawn.
        frame: only submaps of this frame are drawn.

    """

    def __init__(self, geometry: GridGeometry, frame: MapFrame = ARENA) -> None:
        self.frame = frame
        self.grid = OccupancyGrid(geometry)
        """The composed map; read-only."""
        self.submaps: dict[SubmapKey, Submap] = {}
        self._poses: dict[SubmapKey, tuple[Pose2D, MapFrame]] = {}
        """Poses of submaps without cells so far, and their frames."""
        self._size = 0
        """Bytes of the submaps."""
        self._origin = (geometry.origin_x_m, geometry.origin_y_m)
        half_m = 0.5 * geometry.resolution_m
        self._middle_m = (geometry.origin_x_m + half_m, geometry.origin_y_m + half_m)
        """Centre of the grid's cell (0, 0)."""
        self._first = (
            (self._middle_m[0] - geometry.origin_x_m) / geometry.resolution_m,
            (self._middle_m[1] - geometry.origin_y_m) / geometry.resolution_m,
        )
        """The same in cells from the origin."""
        self._measures = (float(geometry.resolution_m), float(geometry.origin_x_m), float(geometry.origin_y_m))
        self._placed: dict[SubmapKey, _Placed] = {}

    def take(
        self,
        key: SubmapKey,
        row: int,
        column: int,
        cells: NDArray[np.int8],
        stamp_ms: int | NDArray[np.int32],
        share: float = 1.0,
    ) -> int:
        """Merge cells into a box of a submap, see `Submap.take`.

        Returns:
            How many classes of the grid changed.

        Raises:
            ValueError: there would be too many submaps, or too large ones, for that share of the limits; nothing has
                changed.

        """
        submap = self.submaps.get(key)
        if submap is not None and isinstance(stamp_ms, int) and 0 <= stamp_ms <= LAST_STAMP_MS:
            first_row, first_column = row - submap.row, column - submap.column
            height, width = submap.evidence.shape
            rows, columns = cells.shape
            is_within = 0 <= first_row <= height - rows and 0 <= first_column <= width - columns
            if is_within and submap.frame == self.frame:
                return self._take_within(key, submap, row, column, cells, stamp_ms)
        self.check(key, (row, column, cells.shape, stamp_ms), None, share)
        return self.take_checked(key, row, column, cells, stamp_ms)

    def take_checked(
        self, key: SubmapKey, row: int, column: int, cells: NDArray[np.int8], stamp_ms: int | NDArray[np.int32]
    ) -> int:
        """As `take`, for cells that `check` has checked."""
        submap = self.submaps.get(key)
        if submap is None:
            submap = Submap(*self._poses.get(key, (IDENTITY, ARENA)))
        before = submap.size
        latest_ms = submap.latest_ms(row, column, *cells.shape)
        told = submap.take_checked(row, column, cells, stamp_ms)
        self._size += submap.size - before
        self.submaps[key] = submap
        self._poses.pop(key, None)
        # Whole tiles: the time has changed for each of their cells.
        height, width = cells.shape
        box = _down(row), _down(column), -_down(-row - height), -_down(-column - width)
        moved = self._moved(submap.T_arena_local, box)
        if latest_ms < 0 or (isinstance(stamp_ms, int) and stamp_ms > latest_ms):
            return self._draw(submap, moved, told)
        return self._redraw_counted(moved)

    def _take_within(
        self, key: SubmapKey, submap: Submap, row: int, column: int, cells: NDArray[np.int8], stamp_ms: int
    ) -> int:
        """As `take_checked`, for cells within the box of a submap that is drawn: one kernel does all of it."""
        placed = self._placed.get(key)
        at = submap.T_arena_local
        if placed is None or placed.at is not at or (placed.row, placed.column) != (submap.row, submap.column):
            cos, sin = math.cos(at.yaw_rad), math.sin(at.yaw_rad)
            motion = cos, sin, float(at.x_m), float(at.y_m)
            placed = self._placed[key] = _Placed(at, submap.row, submap.column, motion, self._lookup(submap))
        grid = self.grid
        more, is_drawn, changed, discovered, box = take_and_draw(
            grid.log_odds,
            grid.stamp_ms,
            submap.evidence,
            submap.stamp_ms,
            row,
            column,
            (submap.row, submap.column),
            cells if cells.dtype is INT8 and cells.flags.carray else kernel_array(cells, INT8),
            stamp_ms,
            placed.lookup,
            placed.motion,
            self._measures,
        )
        submap.occupied += more
        submap.version += 1
        if not is_drawn:
            return self._redraw_counted(box)
        if changed:
            grid.count_drawn(changed, discovered)
        return int(changed)

    def _redraw_counted(self, moved: Box) -> int:
        """Redraw a box where cells have been taken that may not be drawn on top: they are not newer than all others.

        Returns how many classes changed.
        """
        box_cells = np.s_[moved[0] : moved[2], moved[1] : moved[3]]
        classes = np.sign(self.grid.log_odds[box_cells])
        version = self.grid.version
        self._redraw(moved)
        changed = int(np.count_nonzero(np.sign(self.grid.log_odds[box_cells]) != classes))
        if not changed:
            self.grid.version = version
        return changed

    def check(
        self,
        key: SubmapKey,
        box: tuple[int, int, tuple[int, ...], int | NDArray[np.int32]] | None,
        surfaces: NDArray[np.void] | None = None,
        share: float = 1.0,
    ) -> None:
        """Check that cells and surfaces fit their submap, and that there is room for them.

        Args:
            key: the submap.
            box: row, column, shape and stamp of the cells, as for `take`; None for no cells.
            surfaces: as for `take_surfaces`; None for none.
            share: share of the limits that may be used, 0 to 1.

        Raises:
            ValueError: they do not fit, or there is no room.

        """
        submap = self.submaps.get(key)
        more = 0
        if box is not None:
            stamp_ms = box[3]
            if isinstance(stamp_ms, int) and not 0 <= stamp_ms <= LAST_STAMP_MS:
                within = f"0 <= stamp_ms <= {LAST_STAMP_MS} (24 days of a run's clock)"
                raise ValueError(f"expected {within}, got {stamp_ms}")
            if submap is None and len(self.submaps) >= share * SUBMAPS_MAX:
                raise ValueError(f"expected at most {share * SUBMAPS_MAX:.0f} submaps")
            more += (submap or Submap()).growth(*box)
        if surfaces is not None and (submap is not None or box is not None):
            more += surfaces.nbytes - (0 if submap is None or submap.surfaces is None else submap.surfaces.nbytes)
        if more > 0 and self._size + more > share * CELLS_MAX:
            raise ValueError(f"expected submaps of at most {share * CELLS_MAX:.0f} bytes in all")

    def take_surfaces(self, key: SubmapKey, surfaces: NDArray[np.void]) -> None:
        """Set the surfaces (n,) of `SURFACE` of a finished submap. Raises ValueError if there is no room for them."""
        self.check(key, None, surfaces)
        submap = self.submaps.get(key)
        if submap is not None:
            before = submap.size
            submap.surfaces = surfaces
            submap.version += 1
            self._size += submap.size - before

    def move(self, key: SubmapKey, T_arena_local: Pose2D, frame: MapFrame = ARENA) -> None:
        """Set the pose of a submap and the map frame of that pose."""
        submap = self.submaps.get(key)
        if submap is None:
            # The latest poses are kept: a robot's own submap gets its first cells just after its pose.
            self._poses.pop(key, None)
            if len(self._poses) >= SUBMAPS_MAX:
                del self._poses[next(iter(self._poses))]
            self._poses[key] = T_arena_local, frame
            return
        if submap.T_arena_local == T_arena_local and submap.frame == frame:
            return
        was_drawn, before = submap.frame == self.frame, self._box_of(submap)
        submap.T_arena_local, submap.frame = T_arena_local, frame
        if was_drawn:
            self._redraw(before)
        self._draw(submap, self._box_of(submap))

    def move_all(self, places: dict[SubmapKey, Pose2D], frame: MapFrame = ARENA) -> None:
        """Set the poses of several submaps; draws them together if that is less work than one by one."""
        moved = [key for key, place in places.items() if key in self.submaps and place != self.place_of(key, frame)]
        boxes = [self._box_of(self.submaps[key]) for key in moved]
        boxes += [self._moved(places[key], self.submaps[key].box) for key in moved]
        boxes = [box for box in boxes if _cells_of(box)]
        around = _box_around(boxes)
        if len(moved) > 1 and _cells_of(around) < sum(_cells_of(box) for box in boxes):
            for key in moved:
                self.submaps[key].T_arena_local, self.submaps[key].frame = places[key], frame
            self._redraw(around)
        for key, place in places.items():
            self.move(key, place, frame)

    def place_of(self, key: SubmapKey, frame: MapFrame = ARENA) -> Pose2D | None:
        """T_arena_local of a submap in a map frame; None if it does not lie there."""
        submap = self.submaps.get(key)
        return None if submap is None or submap.frame != frame else submap.T_arena_local

    def change_frame(self, frame: MapFrame) -> None:
        """Draw the submaps of this frame in place of those of another."""
        if frame != self.frame:
            self.frame = frame
            self.grid.forget()
            self._redraw((0, 0, *self.grid.geometry.shape))

    def composed(self, frame: MapFrame) -> OccupancyGrid:
        """A new grid of the submaps of any frame."""
        other = SubmapAtlas(self.grid.geometry, frame)
        other.submaps = self.submaps
        other._redraw((0, 0, *self.grid.geometry.shape))
        return other.grid

    def withdraw(self, key: SubmapKey) -> None:
        """Remove a submap that is wrong."""
        self._poses.pop(key, None)
        self._placed.pop(key, None)
        submap = self.submaps.pop(key, None)
        if submap is not None:
            self._size -= submap.size
            self._redraw(self._box_of(submap))

    def forget(self) -> None:
        """Remove all submaps."""
        self.submaps.clear()
        self._poses.clear()
        self._placed.clear()
        self._size = 0
        self.grid.forget()

    def _moved(self, T_arena_local: Pose2D, box: Box) -> Box:
        return self._clipped(moved_box(T_arena_local, box, self.grid.geometry.resolution_m, self._origin))

    def _box_of(self, submap: Submap) -> Box:
        return self._clipped(submap.box_in_arena(self.grid.geometry.resolution_m, self._origin))

    def _clipped(self, box: Box) -> Box:
        height, width = self.grid.geometry.shape
        return max(box[0], 0), max(box[1], 0), min(box[2], height), min(box[3], width)

    def _draw(self, submap: Submap, box: Box, told: Told = ALL) -> int:
        """Draw a submap's cells within a box of the grid, or some of its tiles; returns how many classes changed."""
        if box[0] >= box[2] or box[1] >= box[3] or submap.is_empty or submap.frame != self.frame:
            return 0
        grid = self.grid
        changed, discovered = draw(
            grid.log_odds,
            grid.stamp_ms,
            box,
            submap.evidence,
            submap.stamp_ms,
            self._lookup(submap),
            (told.row, told.column),
            told.tiles,
        )
        grid.count_drawn(changed, discovered)
        return changed

    def _redraw(self, box: Box) -> None:
        """Erase a box of the grid and draw all submaps there."""
        if box[0] >= box[2] or box[1] >= box[3]:
            return
        self.grid.erase(*box)
        for key in sorted(self.submaps):
            submap = self.submaps[key]
            its = self._box_of(submap)
            both = max(its[0], box[0]), max(its[1], box[1]), min(its[2], box[2]), min(its[3], box[3])
            self._draw(submap, both)

    def _lookup(self, submap: Submap) -> tuple[float, float, float, float]:
        """(cos, sin, row, column): cell (i, j) is the submap's (row + cos·i + sin·j, column − sin·i + cos·j)."""
        geometry = self.grid.geometry
        if submap.T_arena_local == IDENTITY:
            return 1.0, 0.0, self._first[1] - submap.row, self._first[0] - submap.column
        T_local_arena = submap.T_arena_local.inverse()
        cos, sin = math.cos(T_local_arena.yaw_rad), math.sin(T_local_arena.yaw_rad)
        # Centre of the grid's cell (0, 0), in cells of the frame `local`.
        x_m, y_m = self._middle_m
        at_x = (T_local_arena.x_m + cos * x_m - sin * y_m - geometry.origin_x_m) / geometry.resolution_m
        at_y = (T_local_arena.y_m + sin * x_m + cos * y_m - geometry.origin_y_m) / geometry.resolution_m
        return cos, sin, at_y - submap.row, at_x - submap.column


def _down(cell: int) -> int:
    return cell // TILE_CELLS * TILE_CELLS


def _cells_of(box: Box) -> int:
    return max(box[2] - box[0], 0) * max(box[3] - box[1], 0)


def _box_around(boxes: list[Box]) -> Box:
    """The smallest box that holds all of these; an empty one for none."""
    if not boxes:
        return 0, 0, 0, 0
    first_rows, first_columns, end_rows, end_columns = zip(*boxes, strict=True)
    return min(first_rows), min(first_columns), max(end_rows), max(end_columns)
