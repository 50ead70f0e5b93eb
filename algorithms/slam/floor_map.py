"""A floor that is known before the run, as submaps in the arena frame that were observed before all others.

Robots localise on these submaps and correct the map as on those of another robot. Later observations replace cells.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from robrain.algorithms.numeric.elementary_functions import arctan2
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.algorithms.slam.map_patch import whole_map
from robrain.algorithms.slam.submap import BLOCK_CELLS, PARTS, SURFACE, VIEW_PARTS, VIEWS
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.protocol.messages.maps.map_messages import FLOOR, MapPatch
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from robrain.protocol.model.map_frame import ARENA

STEP_CELLS, SIDE_CELLS = 4 * BLOCK_CELLS, 6 * BLOCK_CELLS
"""Step and side of submaps. They overlap, so that a robot is well inside one of them; a match copies one of them."""
AROUND = np.ones((5, 5), np.bool_)
"""Cells of a wall beside a free cell: one that it shares with the floor, and one with the place of its surface."""


class FloorMap(NamedTuple):
    """Cells of a floor, and the places of its walls."""

    geometry: GridGeometry
    classes: NDArray[np.int8]
    """(H, W), row 0 at the lowest y. All beyond counts as wall."""
    walls: Floats
    """(N, 4): x and y, metres, arena frame, and the unit vector of the direction in which a robot sees the wall."""


def floor_of_cells(geometry: GridGeometry, classes: NDArray[np.int8]) -> FloorMap:
    """A floor whose walls lie in the middles of those occupied cells that have a free one beside them."""
    free = np.pad(classes == FREE, 1).astype(np.int8)
    right = free[1:-1, :-2] - free[1:-1, 2:]
    up = free[:-2, 1:-1] - free[2:, 1:-1]
    rows, columns = np.nonzero((classes == OCCUPIED) & ((right != 0) | (up != 0)))
    along = np.column_stack([right[rows, columns], up[rows, columns]])
    return FloorMap(geometry, classes, _walls(geometry, columns + 0.5, rows + 0.5, along))


def floor_of_atlas(atlas: SubmapAtlas) -> FloorMap:
    """The composed map of an atlas, with the walls as its finished submaps have them."""
    geometry, walls = atlas.grid.geometry, [np.empty((0, 4))]
    for _, submap in sorted(atlas.submaps.items()):
        if submap.surfaces is not None and submap.frame == ARENA:
            surfaces, place = submap.surfaces, submap.T_arena_local
            x = surfaces["column"] + 0.5 + surfaces["right"] / PARTS
            y = surfaces["row"] + 0.5 + surfaces["up"] / PARTS
            x_m, y_m, right, up = _walls(geometry, x, y, VIEWS[surfaces["view"]]).T
            cos, sin = math.cos(place.yaw_rad), math.sin(place.yaw_rad)
            at = place.x_m + cos * x_m - sin * y_m, place.y_m + sin * x_m + cos * y_m
            walls.append(np.column_stack([*at, cos * right - sin * up, sin * right + cos * up]))
    return FloorMap(geometry, atlas.grid.classes(), np.concatenate(walls))


def _walls(geometry: GridGeometry, x: NDArray[Any], y: NDArray[Any], along: NDArray[Any]) -> Floats:
    x_m = geometry.origin_x_m + x * geometry.resolution_m
    y_m = geometry.origin_y_m + y * geometry.resolution_m
    return np.column_stack([x_m, y_m, along]).astype(np.float64)


def floor_patch(floor: FloorMap, team: GridGeometry) -> MapPatch | None:
    """The floor on a team's grid, as a message of several submaps; None if no free cell of it lies there."""
    cells = _resampled(floor, team)
    surfaces = _surfaces(floor.walls, team, cells == OCCUPIED)
    atlas = SubmapAtlas(team)
    for top in range(0, team.height, STEP_CELLS):
        for left in range(0, team.width, STEP_CELLS):
            tile = cells[top : top + SIDE_CELLS, left : left + SIDE_CELLS]
            if (tile == FREE).any():
                key = FLOOR, len(atlas.submaps)
                atlas.merge(key, top, left, tile, 0)
                down, across = surfaces["row"] - top, surfaces["column"] - left
                is_here = (down >= 0) & (down < SIDE_CELLS) & (across >= 0) & (across < SIDE_CELLS)
                atlas.set_surfaces(key, surfaces[is_here])
    return whole_map(FLOOR, atlas, sorted(atlas.submaps))


def _resampled(floor: FloorMap, team: GridGeometry) -> NDArray[np.int8]:
    """Classes of the team's cells: occupied if any part of a cell is, and free if most of it is.

    Of walls only the cells near free ones are kept, as robots see them.
    """
    source = floor.geometry
    parts = 2 * math.ceil(team.resolution_m / source.resolution_m - 1e-6)
    classes = np.pad(floor.classes, 1, constant_values=OCCUPIED)
    free, occupied = np.zeros(team.shape, np.int32), np.zeros(team.shape, np.bool_)

    def places(cells: int, origin_m: float, source_cells: int, source_origin_m: float, part: int) -> NDArray[np.int64]:
        at_m = origin_m + (np.arange(cells) + (part + 0.5) / parts) * team.resolution_m
        at: NDArray[np.int64] = np.floor((at_m - source_origin_m) / source.resolution_m).astype(np.int64)
        return at.clip(-1, source_cells) + 1  # of the padding

    for down in range(parts):
        rows = places(team.height, team.origin_y_m, source.height, source.origin_y_m, down)
        for across in range(parts):
            columns = places(team.width, team.origin_x_m, source.width, source.origin_x_m, across)
            part = classes[np.ix_(rows, columns)]
            free += part == FREE
            occupied |= part == OCCUPIED
    is_free = ~occupied & (2 * free > parts**2)
    is_wall = occupied & ndimage.binary_dilation(is_free, AROUND)
    return np.where(is_wall, OCCUPIED, np.where(is_free, FREE, UNKNOWN)).astype(np.int8)


def _surfaces(walls: Floats, team: GridGeometry, occupied: NDArray[np.bool_]) -> NDArray[np.void]:
    """Surfaces of `SURFACE`: the mean of the walls in each occupied cell, unless robots see them from both sides."""
    at = (walls[:, :2] - (team.origin_x_m, team.origin_y_m)) / team.resolution_m
    columns, rows = np.floor(at).astype(np.int64).T
    is_inside = (rows >= 0) & (rows < team.height) & (columns >= 0) & (columns < team.width)
    at, along, flat = at[is_inside], walls[is_inside, 2:], (rows * team.width + columns)[is_inside]
    cells, cell = np.unique(flat, return_inverse=True)
    count = np.bincount(cell)
    x, y, right, up = (np.bincount(cell, each) / count for each in (*at.T, *along.T))
    rows, columns = np.divmod(cells, team.width)
    is_one = occupied[rows, columns] & (right**2 + up**2 > 0.25)
    surfaces = np.zeros(len(cells), SURFACE)
    surfaces["row"], surfaces["column"] = rows, columns
    surfaces["right"] = np.rint((x - columns - 0.5) * PARTS)
    surfaces["up"] = np.rint((y - rows - 0.5) * PARTS)
    surfaces["view"] = np.rint(arctan2(up, right) * (VIEW_PARTS / math.tau)).astype(np.int64) % VIEW_PARTS
    return surfaces[is_one]
