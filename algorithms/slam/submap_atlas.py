"""The team's map, composed of submaps that can be moved or withdrawn later.

Where submaps overlap, the cell observed last wins; at equal times an occupied cell wins: the rule of
`OccupancyGrid.merge_patch`. While no submap has been moved, the composition equals all patches merged into one grid. A
submap that moves is erased at its old pose and drawn at the new one, by nearest-neighbour lookup.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.mapping.occupancy_grid import LAST_STAMP_MS, OccupancyGrid
from robrain.algorithms.slam.submap import TILE_CELLS, Box, Submap, SubmapStep, box_after, moved_box
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.map_frame import ARENA, MapFrame

SUBMAPS_MAX = 8192
"""Largest number of submaps of an atlas; further ones are refused."""
CELLS_MAX = 1 << 27
"""Limit for the bytes of all submaps: one for each cell, 11 for each surface. A patch that needs more is refused."""

SubmapKey = tuple[str, int]
"""Name of a robot and number of its submap."""


@njit(cache=True, nogil=True)
def draw_tiles(
    log_odds: NDArray[np.int8],
    stamps_ms: NDArray[np.int32],
    grid: tuple[float, float, float],
    begins: NDArray[np.int64],
    firsts: NDArray[np.int64],
    places: NDArray[np.float64],
    at: NDArray[np.int32],
    tiles_ms: NDArray[np.int32],
    cells: NDArray[np.int8],
) -> tuple[int, int]:
    """Draw tiles of one submap after the other.

    Args:
        log_odds: of the team's grid.
        stamps_ms: likewise.
        grid: its resolution and origin, metres.
        begins: (submaps + 1,) where each submap's tiles begin in the next arrays but two.
        firsts: (submaps, 2) row and column of each submap's first cell.
        places: (submaps, 8) where it lies: `motion` and `lookup` of `SubmapPlace`.
        at: (tiles, 2) as in `Tiles`.
        tiles_ms: (tiles,) likewise.
        cells: (tiles, 8, 8) likewise.

    Returns:
        Numbers of changed classes and of newly known cells.

    """
    changed, discovered = 0, 0
    for submap in range(begins.shape[0] - 1):
        first_row, first_column = firsts[submap]
        cos, sin, x_m, y_m, lookup_cos, lookup_sin, lookup_row, lookup_column = places[submap]
        for tile in range(begins[submap], begins[submap + 1]):
            top, left = at[tile, 0] * TILE_CELLS, at[tile, 1] * TILE_CELLS
            bottom, end = top + TILE_CELLS, left + TILE_CELLS
            box = first_row + top, first_column + left, first_row + bottom, first_column + end
            box = box_after((cos, sin, x_m, y_m), box, grid)
            for i in range(max(box[0], 0), min(box[2], log_odds.shape[0])):
                for j in range(max(box[1], 0), min(box[3], log_odds.shape[1])):
                    row = math.floor(lookup_row + lookup_cos * i + lookup_sin * j)
                    column = math.floor(lookup_column - lookup_sin * i + lookup_cos * j)
                    if row < top or column < left or row >= bottom or column >= end:
                        continue
                    flips, finds = _lay(
                        log_odds, stamps_ms, i, j, cells[tile, row - top, column - left], tiles_ms[tile]
                    )
                    changed += flips
                    discovered += finds
    return changed, discovered


@njit(cache=True, nogil=True)
def draw(
    log_odds: NDArray[np.int8],
    stamps_ms: NDArray[np.int32],
    box: Box,
    evidence: NDArray[np.int8],
    tile_stamps_ms: NDArray[np.int32],
    lookup: tuple[float, float, float, float],
) -> tuple[int, int]:
    """Draw a submap's cells within a box of the grid; numbers of changed classes and of newly known cells."""
    cos, sin, first_row, first_column = lookup
    height, width = evidence.shape
    changed, discovered = 0, 0
    for i in range(box[0], box[2]):
        for j in range(box[1], box[3]):
            row = math.floor(first_row + cos * i + sin * j)
            column = math.floor(first_column - sin * i + cos * j)
            if row < 0 or column < 0 or row >= height or column >= width:
                continue
            stamp_ms = tile_stamps_ms[row // TILE_CELLS, column // TILE_CELLS]
            flips, finds = _lay(log_odds, stamps_ms, i, j, evidence[row, column], stamp_ms)
            changed += flips
            discovered += finds
    return changed, discovered


@njit(cache=True, nogil=True)
def _lay(
    log_odds: NDArray[np.int8], stamps_ms: NDArray[np.int32], i: int, j: int, statement: int, stamp_ms: int
) -> tuple[int, int]:
    """Draw one cell; changed classes and newly known cells, each 0 or 1."""
    if statement == 0:
        return 0, 0
    value = log_odds[i, j]
    is_newer = stamp_ms > stamps_ms[i, j] or (stamp_ms == stamps_ms[i, j] and statement > 0 and value < 0)
    if value != 0 and not is_newer:
        return 0, 0
    log_odds[i, j] = statement
    stamps_ms[i, j] = stamp_ms
    if value == 0:
        return 1, 1
    return int((statement > 0) != (value > 0)), 0


class SubmapPlace(NamedTuple):
    """Place of a submap's cells in the grid, and the values from which it was computed."""

    at: Pose2D
    first: tuple[int, int]
    """Row and column of the submap's first cell."""
    numbers: tuple[float, ...]
    """`motion`: cos, sin, x and y of `at`; then `lookup`: as `SubmapAtlas._lookup` returns it."""


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
        half_m = 0.5 * geometry.resolution_m
        self._middle_m = (geometry.origin_x_m + half_m, geometry.origin_y_m + half_m)
        """Centre of the grid's cell (0, 0)."""
        self._first = (
            (self._middle_m[0] - geometry.origin_x_m) / geometry.resolution_m,
            (self._middle_m[1] - geometry.origin_y_m) / geometry.resolution_m,
        )
        """The same in cells from the origin."""
        self._measures = (float(geometry.resolution_m), float(geometry.origin_x_m), float(geometry.origin_y_m))
        self._places: dict[SubmapKey, SubmapPlace] = {}
        self._held: list[Box] | None = None
        """Boxes to draw again in the end; None if each is drawn at once."""

    def merge(
        self,
        key: SubmapKey,
        row: int,
        column: int,
        cells: NDArray[np.int8],
        stamp_ms: int | NDArray[np.int32],
        share: float = 1.0,
    ) -> int:
        """Merge cells into a box of a submap, see `Submap.merge`.

        Returns:
            How many classes of the grid changed.

        Raises:
            ValueError: there would be too many submaps, or too large ones, for that share of the limits; nothing has
                changed.

        """
        self.check(key, (row, column, cells.shape, stamp_ms), None, share)
        return self.apply_step(key, self.shaped(key).after(row, column, cells, stamp_ms))

    def shaped(self, key: SubmapKey) -> Submap:
        """The submap as it is; where there is none yet, an empty one at its published pose."""
        submap = self.submaps.get(key)
        return Submap(*self._poses.get(key, (IDENTITY, ARENA))) if submap is None else submap

    def apply_step(self, key: SubmapKey, step: SubmapStep) -> int:
        """Take the result of a patch, which `check` has checked, on `shaped(key)`; returns as `merge`."""
        if step.is_newest:
            return self.apply_steps([(key, step)])
        submap = self._begun(key)
        self._size += step.evidence.nbytes - submap.evidence.nbytes
        submap.become(step)
        return self._redraw_counted(self._moved(submap.T_arena_local, step.box)) if submap.frame == self.frame else 0

    def apply_steps(self, steps: Sequence[tuple[SubmapKey, SubmapStep]]) -> int:
        """As `apply_step` for one after the other, all of them newest: drawn by one kernel."""
        begins, firsts, places, at, stamps_ms, cells = [0], [], [], [], [], []
        submaps = self.submaps
        for key, step in steps:
            submap, reported = submaps.get(key) or self._begun(key), step.tiles
            self._size += step.evidence.nbytes - submap.evidence.nbytes
            submap.become(step)
            if submap.frame == self.frame and len(reported.at):
                place = self._places.get(key)
                here, first = submap.T_arena_local, (step.row, step.column)
                if place is None or place.at is not here or place.first != first:
                    place = self._places[key] = self._place(submap)
                begins.append(begins[-1] + len(reported.at))
                firsts.append(first)
                places.append(place.numbers)
                at.append(reported.at)
                stamps_ms.append(reported.stamps_ms)
                cells.append(reported.cells)
        if not firsts:
            return 0
        is_one = len(firsts) == 1
        grid = self.grid
        changed, discovered = draw_tiles(
            grid.log_odds,
            grid.stamp_ms,
            self._measures,
            np.array(begins),
            np.array(firsts),
            np.array(places),
            at[0] if is_one else np.concatenate(at),
            stamps_ms[0] if is_one else np.concatenate(stamps_ms),
            cells[0] if is_one else np.concatenate(cells),
        )
        grid.count_drawn(changed, discovered)
        return int(changed)

    def _begun(self, key: SubmapKey) -> Submap:
        """The submap, which is there from now on."""
        submap = self.submaps.get(key)
        if submap is None:
            submap = self.submaps[key] = self.shaped(key)
            self._poses.pop(key, None)
        return submap

    def _place(self, submap: Submap) -> SubmapPlace:
        at = submap.T_arena_local
        motion = math.cos(at.yaw_rad), math.sin(at.yaw_rad), at.x_m, at.y_m
        return SubmapPlace(at, (submap.row, submap.column), (*motion, *self._lookup(submap)))

    def _redraw_counted(self, moved: Box) -> int:
        """Redraw a box where cells have been taken that may not be drawn on top: they are not newer than all others.

        Returns how many classes changed.
        """
        if self._held is not None:
            self._held.append(moved)
            return 0
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
            box: row, column, shape and stamp of the cells, as for `merge`; None for no cells.
            surfaces: as for `set_surfaces`; None for none.
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
        if more > 0 and not self.has_room(more, share):
            raise ValueError(f"expected submaps of at most {share * CELLS_MAX:.0f} bytes in all")

    def has_room(self, more: int, share: float) -> bool:
        """Whether submaps may grow by this number of bytes, if they may fill that share of the limit, 0 to 1."""
        return self._size + more <= share * CELLS_MAX

    def set_surfaces(self, key: SubmapKey, surfaces: NDArray[np.void]) -> None:
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
        if self._held is None:
            self._draw(submap, self._box_of(submap))
        else:
            self._held.append(self._box_of(submap))

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

    def hold(self) -> None:
        """Defer drawing until `draw_held`; otherwise each of many overlapping submaps redraws all others."""
        self._held = []

    def draw_held(self) -> int:
        """Draw all changes since `hold`; returns the number of cells whose class changed."""
        boxes, self._held = [box for box in self._held or () if _cells_of(box)], None
        around = _box_around(boxes)
        if _cells_of(around) < sum(_cells_of(box) for box in boxes):
            boxes = [around]
        return sum(self._redraw_counted(box) for box in boxes)

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

    def is_covered(self, submap: Submap) -> bool:
        """Whether the grid shows no cell of a submap, as all its cells there were observed later in other submaps."""
        top, left, bottom, right = self._box_of(submap)
        cells = np.zeros((max(bottom - top, 0), max(right - left, 0)), np.int8)
        stamps_ms = np.zeros(cells.shape, np.int32)
        cos, sin, row, column = self._lookup(submap)
        lookup = cos, sin, row + cos * top + sin * left, column - sin * top + cos * left
        draw(cells, stamps_ms, (0, 0, *cells.shape), submap.evidence, submap.stamp_ms, lookup)
        is_shown = (cells != 0) & (stamps_ms >= self.grid.stamp_ms[top:bottom, left:right])
        return submap.frame == self.frame and not is_shown.any()

    def withdraw(self, key: SubmapKey) -> None:
        """Remove a submap that is wrong or covered."""
        self._poses.pop(key, None)
        self._places.pop(key, None)
        submap = self.submaps.pop(key, None)
        if submap is not None:
            self._size -= submap.size
            self._redraw(self._box_of(submap))

    def forget(self) -> None:
        """Remove all submaps."""
        self.submaps.clear()
        self._poses.clear()
        self._places.clear()
        self._size = 0
        self.grid.forget()

    def _moved(self, T_arena_local: Pose2D, box: Box) -> Box:
        top, left, bottom, right = moved_box(T_arena_local, box, self._measures)
        height, width = self.grid.geometry.shape
        return max(top, 0), max(left, 0), min(bottom, height), min(right, width)

    def _box_of(self, submap: Submap) -> Box:
        return self._moved(submap.T_arena_local, submap.box)

    def _draw(self, submap: Submap, box: Box) -> None:
        """Draw a submap's cells within a box of the grid."""
        if box[0] >= box[2] or box[1] >= box[3] or submap.is_empty or submap.frame != self.frame:
            return
        grid = self.grid
        changed, discovered = draw(
            grid.log_odds, grid.stamp_ms, box, submap.evidence, submap.stamp_ms, self._lookup(submap)
        )
        grid.count_drawn(changed, discovered)

    def _redraw(self, box: Box) -> None:
        """Erase a box of the grid and draw all submaps there."""
        if box[0] >= box[2] or box[1] >= box[3]:
            return
        if self._held is not None:
            self._held.append(box)
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


def _cells_of(box: Box) -> int:
    return max(box[2] - box[0], 0) * max(box[3] - box[1], 0)


def _box_around(boxes: list[Box]) -> Box:
    """The smallest box that holds all of these; an empty one for none."""
    if not boxes:
        return 0, 0, 0, 0
    first_rows, first_columns, end_rows, end_columns = zip(*boxes, strict=True)
    return min(first_rows), min(first_columns), max(end_rows), max(end_columns)
