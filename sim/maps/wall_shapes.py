"""Walls as rectangles for the physics: few shapes, and only where a robot could touch them."""

import numpy as np
import pymunk
from numpy.typing import NDArray
from scipy import ndimage

from robrain.sim.maps.floor_plan import FloorPlan

EDGE_THICKNESS_M = 1.0


def touchable_cells(occupied: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(H, W), the occupied cells with a free one among their eight neighbours."""
    return occupied & ndimage.binary_dilation(~occupied, structure=np.ones((3, 3), dtype=np.bool_))


def wall_rectangles(occupied: NDArray[np.bool_]) -> NDArray[np.int32]:
    """(N, 4) cells row0, col0, row1, col1, the latter two exclusive: rectangles whose union is `touchable_cells`.

    Greedy: the first uncovered cell, in row order, becomes the lower left corner of a rectangle of touchable cells. The
    rectangle is the one that covers the most new cells. Rectangles may overlap where walls cross. Same grid, same
    rectangles.
    """
    return _cover(touchable_cells(np.asarray(occupied, dtype=np.bool_)))


def add_walls(
    space: pymunk.Space, plan: FloorPlan, *, collision_type: int, friction: float = 0.4, elasticity: float = 0.1
) -> list[pymunk.Poly]:
    """Adds the plan's walls to the space as static boxes, metres in the arena frame, and returns them.

    The last four boxes close the arena's edge from outside, EDGE_THICKNESS_M thick.
    """
    corners_m = wall_rectangles(plan.occupied) * plan.resolution_m
    corners_m += np.array([plan.origin_y_m, plan.origin_x_m] * 2)
    boxes = [pymunk.BB(left, bottom, right, top) for bottom, left, top, right in corners_m.tolist()]
    boxes += _edge_boxes(plan)
    shapes = [pymunk.Poly.create_box_bb(space.static_body, box) for box in boxes]
    for shape in shapes:
        shape.collision_type = collision_type
        shape.friction = friction
        shape.elasticity = elasticity
    space.add(*shapes)
    return shapes


def _edge_boxes(plan: FloorPlan) -> list[pymunk.BB]:
    width_m, height_m = plan.size_m
    left, bottom = plan.origin_x_m, plan.origin_y_m
    right, top = left + width_m, bottom + height_m
    thick = EDGE_THICKNESS_M
    return [
        pymunk.BB(left - thick, bottom - thick, left, top + thick),
        pymunk.BB(right, bottom - thick, right + thick, top + thick),
        pymunk.BB(left - thick, bottom - thick, right + thick, bottom),
        pymunk.BB(left - thick, top, right + thick, top + thick),
    ]


def _cover(wall: NDArray[np.bool_]) -> NDArray[np.int32]:
    # No kernel: a run is set up before its kernels are compiled.
    rows = wall.shape[0]
    ends = _run_ends(wall)
    covered = np.zeros(wall.shape, np.bool_)
    found: list[tuple[int, int, int, int]] = []
    for row, col in np.argwhere(wall).tolist():
        if covered[row, col]:
            continue
        best_gain, best_row1, best_col1 = 0, row, col
        limit = int(ends[row, col])
        row1 = row
        # Each height has one widest rectangle; the width only shrinks as the height grows.
        while row1 < rows and wall[row1, col]:
            limit = min(limit, int(ends[row1, col]))
            row1 += 1
            gain = (row1 - row) * (limit - col) - int(np.count_nonzero(covered[row:row1, col:limit]))
            if gain > best_gain:
                best_gain, best_row1, best_col1 = gain, row1, limit
        covered[row:best_row1, col:best_col1] = True
        found.append((row, col, best_row1, best_col1))
    return np.array(found, np.int32).reshape(-1, 4)


def _run_ends(wall: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(H, W), for each wall cell the first column behind its run of wall cells."""
    columns = wall.shape[1]
    ends = np.where(wall, columns, np.arange(columns))
    reached: NDArray[np.int64] = np.minimum.accumulate(ends[:, ::-1], axis=1)[:, ::-1]
    return reached
