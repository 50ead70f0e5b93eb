"""Where the known floor ends: the places that exploration can go to next.

After Yamauchi, *A Frontier-Based Approach for Autonomous Exploration*, CIRA 1997. Long frontiers are split, so that
several robots can share one.
"""

import math

import msgspec
import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.numeric.kernel_array import BOOL, kernel_array
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN

SPLIT_CELLS = 30
MIN_CELLS = 4
"""Fewer frontier cells that touch are none: a gap between two beams, or the slit between two boards."""


class Frontier(msgspec.Struct, frozen=True):
    """A group of frontier cells: the member nearest to their centroid, and their number."""

    row: int
    column: int
    cells: int


def find_frontiers(classes: NDArray[np.int8], min_cells: int = MIN_CELLS) -> list[Frontier]:
    """The frontiers of a map, largest first, then by row and column.

    A frontier cell is FREE and has an UNKNOWN cell above, below, left or right of it. Cells that touch, corners
    included, form a group. Groups of fewer than `min_cells` are dropped; those longer than `SPLIT_CELLS` are cut across
    their principal axis until no piece is. `classes` (H, W) as of `OccupancyGrid.classes`.
    """
    labels, groups = touching(frontier_mask(classes), corners=True)
    if groups == 0:
        return []
    members = np.argwhere(labels > 0)
    label_of = labels[members[:, 0], members[:, 1]]
    order = np.argsort(label_of, kind="stable")
    borders = np.cumsum(np.bincount(label_of, minlength=groups + 1))[1:-1]
    frontiers = [
        _frontier_of(piece)
        for group in np.split(members[order], borders)
        if group.shape[0] >= min_cells
        for piece in _split(group)
    ]
    return sorted(frontiers, key=lambda frontier: (-frontier.cells, frontier.row, frontier.column))


def unknown_beyond(classes: NDArray[np.int8], row: int, column: int, reach: int) -> int:
    """Number of unknown cells that a robot at a frontier may find: no known wall separates them from it.

    Args:
        classes: (H, W) as of `OccupancyGrid.classes`.
        row: of the frontier.
        column: of the frontier.
        reach: cells farther away, by rows or columns, do not count.

    """
    top, left = max(row - reach, 0), max(column - reach, 0)
    box = classes[top : row + reach + 1, left : column + reach + 1]
    labels, _ = touching(box != OCCUPIED)
    here = labels[row - top, column - left]
    return int(np.count_nonzero((labels == here) & (box == UNKNOWN))) if here else 0


def touching(cells: NDArray[np.bool_], *, corners: bool = False) -> tuple[NDArray[np.int32], int]:
    """The number of the group of each cell (H, W), 0 where it is False, and how many groups of cells touch.

    Groups are numbered by their first cells, row by row, as scipy's `ndimage.label` does, which takes 13 MB of a robot.

    Args:
        cells: (H, W).
        corners: whether cells touch that have only a corner in common.

    """
    labels: NDArray[np.int32]
    labels, groups = _touching(kernel_array(cells, BOOL), corners)
    return labels, groups


@njit(cache=True, nogil=True)
def _touching(cells: NDArray[np.bool_], corners: bool) -> tuple[NDArray[np.int32], int]:
    height, width = cells.shape
    labels = np.zeros((height, width), np.int32)
    waiting = np.empty((height * width, 2), np.int32)
    groups = 0
    for first_row in range(height):
        for first_column in range(width):
            if not cells[first_row, first_column] or labels[first_row, first_column]:
                continue
            groups += 1
            labels[first_row, first_column] = groups
            waiting[0] = first_row, first_column
            count = 1
            while count:
                count -= 1
                middle_row, middle_column = waiting[count]
                for row in range(max(middle_row - 1, 0), min(middle_row + 2, height)):
                    for column in range(max(middle_column - 1, 0), min(middle_column + 2, width)):
                        is_corner = row != middle_row and column != middle_column
                        if cells[row, column] and not labels[row, column] and (corners or not is_corner):
                            labels[row, column] = groups
                            waiting[count] = row, column
                            count += 1
    return labels, groups


def frontier_mask(classes: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Which cells are frontier cells, (H, W); beyond the grid nothing is unknown."""
    unknown: NDArray[np.bool_] = classes == UNKNOWN
    beside = np.zeros_like(unknown)
    beside[1:] |= unknown[:-1]
    beside[:-1] |= unknown[1:]
    beside[:, 1:] |= unknown[:, :-1]
    beside[:, :-1] |= unknown[:, 1:]
    beside &= classes == FREE
    return beside


def _split(cells: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Pieces (n, 2) whose extent along their principal axis is below `SPLIT_CELLS`."""
    spans = np.ptp(cells, axis=0)
    if math.hypot(spans[0], spans[1]) < SPLIT_CELLS:
        return [cells]
    rows, columns = (cells - cells.mean(axis=0)).T
    # Direction of largest variance of a 2 × 2 covariance, in closed form.
    axis_rad = 0.5 * math.atan2(2 * float((rows * columns).sum()), float((columns**2).sum() - (rows**2).sum()))
    along = columns * math.cos(axis_rad) + rows * math.sin(axis_rad)
    along -= along.min()
    extent = float(along.max())
    if extent < SPLIT_CELLS:
        return [cells]
    pieces = math.floor(extent / SPLIT_CELLS) + 1
    piece_of = np.minimum((along * (pieces / extent)).astype(np.int64), pieces - 1)
    return [
        part for piece in range(pieces) if (chosen := cells[piece_of == piece]).shape[0] > 0 for part in _split(chosen)
    ]


def _frontier_of(cells: NDArray[np.int64]) -> Frontier:
    apart = ((cells - cells.mean(axis=0)) ** 2).sum(axis=1)
    # Rounded, so that cells equally near in exact arithmetic are so here; argmin takes the first in row order.
    row, column = cells[np.argmin(apart.round(6))]
    return Frontier(int(row), int(column), int(cells.shape[0]))
