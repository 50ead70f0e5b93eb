"""Where on a map a set of walls may lie, with no idea of where: branch and bound over all places and directions.

The method is that of Hess et al., *Real-time loop closure in 2D LIDAR SLAM*, ICRA 2016, section V: nearness to walls is
kept at several resolutions, each cell of a coarse one with the best of the cells that it stands for, so that whole
regions are ruled out at once. Unlike there, all places that do nearly as well as the best one are found: rooms look
alike, and the caller has to know.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.localization.scan_match import distance_window
from robrain.algorithms.numeric.kernel_array import FLOAT64, INT8, Floats, kernel_array
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry

YAWS = 120
"""Directions tried: 3° apart."""
REACH_CELLS = 4
"""Walls within this distance of a wall of the map count, the less the farther."""
LEVELS = 3
"""The coarsest resolution has cells of 2³ of the map's."""
BEST = 255.0
"""Nearness of a point that lies on a wall."""
UNKNOWN = 90.0
"""Nearness of a point that lies where nothing is known: maps may overlap in part only."""
SCORE_MIN = 0.5
"""Mean nearness, as a share of `BEST`, below which a place is none."""
NEARLY = 0.8
"""Default share of the best score that a place needs."""
NODES_MAX = 4096
STRIDE = 61
"""Prime, so that it visits each point once unless their number is a multiple of it."""


def search_places(
    log_odds: NDArray[np.int8], geometry: GridGeometry, points: Floats, places_max: int, nearly: float = NEARLY
) -> list[tuple[float, Pose2D]]:
    """Poses on the floor of a map at which `points` lie on its walls, best first, with their scores (0 to 1).

    Args:
        log_odds: int8 (H, W), an `OccupancyGrid`'s.
        geometry: of that grid.
        points: (K, 2) places of walls, metres, in the frame that is looked for.
        places_max: largest number of poses returned. They may be close to each other.
        nearly: places whose score is at least this share of the best one's are returned.

    """
    rows, columns = np.flatnonzero((log_odds != 0).any(axis=1)), np.flatnonzero((log_odds != 0).any(axis=0))
    if not len(points) or rows.size == 0:
        return []
    row, column = int(rows[0]), int(columns[0])
    box = kernel_array(log_odds[row : int(rows[-1]) + 1, column : int(columns[-1]) + 1], INT8)
    nodes = _search(box, kernel_array(points / geometry.resolution_m, FLOAT64), nearly)
    best_first = sorted(nodes.tolist(), key=lambda node: (-node[0], node[1:]))[:places_max]
    found = []
    for score, i, j, k in best_first:
        middle = geometry.center_of(row + int(i), column + int(j))
        found.append((score / BEST, Pose2D(middle.x_m, middle.y_m, math.remainder(k * math.tau / YAWS, math.tau))))
    return found


@njit(cache=True, nogil=True)
def _pyramid(log_odds: NDArray[np.int8], margin: int) -> NDArray[np.uint8]:
    """(LEVELS + 1, H + 2 margin, W + 2 margin): nearness to a wall, the best of 2^level cells up and right."""
    height, width = log_odds.shape[0] + 2 * margin, log_odds.shape[1] + 2 * margin
    field = distance_window(log_odds, -margin, -margin, height, width, REACH_CELLS)
    levels = np.zeros((LEVELS + 1, height, width), np.uint8)
    for i in range(height):
        for j in range(width):
            levels[0, i, j] = np.uint8(BEST * (1.0 - field[i, j] / REACH_CELLS))
            row, column = i - margin, j - margin
            is_inside = 0 <= row < log_odds.shape[0] and 0 <= column < log_odds.shape[1]
            if not is_inside or log_odds[row, column] == 0:
                levels[0, i, j] = max(levels[0, i, j], np.uint8(UNKNOWN))
    for level in range(1, LEVELS + 1):
        half = 1 << (level - 1)
        for i in range(height):
            for j in range(width):
                most = levels[level - 1, i, j]
                if i + half < height:
                    most = max(most, levels[level - 1, i + half, j])
                    if j + half < width:
                        most = max(most, levels[level - 1, i + half, j + half])
                if j + half < width:
                    most = max(most, levels[level - 1, i, j + half])
                levels[level, i, j] = most
    return levels


@njit(cache=True, nogil=True)
def _score(
    levels: NDArray[np.uint8], level: int, margin: int, i: int, j: int, offsets: NDArray[np.int32], least: float
) -> float:
    """Mean nearness of the points at cell (i, j), or a bound for 2^level cells from there; 0 once below `least`."""
    count = offsets.shape[0]
    height, width = levels.shape[1], levels.shape[2]
    total: float = 0.0
    needed = least * count
    for n in range(count):
        row, column = i + offsets[n, 0] + margin, j + offsets[n, 1] + margin
        inside = 0 <= row < height and 0 <= column < width
        total += float(levels[level, row, column]) if inside else UNKNOWN
        if total + BEST * (count - 1 - n) < needed:
            return 0.0
    mean: float = total / count
    return mean


@njit(cache=True, nogil=True)
def _best_leaf(
    levels: NDArray[np.uint8],
    log_odds: NDArray[np.int8],
    margin: int,
    i: int,
    j: int,
    offsets: NDArray[np.int32],
    least: float,
) -> tuple[float, int, int]:
    """The best free cell among the 2^LEVELS from (i, j) up and right whose score is at least `least`; 0 if none."""
    height, width = log_odds.shape
    best, best_i, best_j = 0.0, 0, 0
    stack = np.empty((4 * (LEVELS + 1), 3), np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2] = LEVELS, i, j
    size = 1
    while size:
        size -= 1
        level, row, column = stack[size, 0], stack[size, 1], stack[size, 2]
        if row >= height or column >= width:
            continue
        score = _score(levels, level, margin, row, column, offsets, max(least, best))
        if score <= best or score < least:
            continue
        if level == 0:
            if log_odds[row, column] < 0:
                best, best_i, best_j = score, row, column
            continue
        half = 1 << (level - 1)
        for up in range(2):
            for right in range(2):
                stack[size, 0] = level - 1
                stack[size, 1], stack[size, 2] = row + up * half, column + right * half
                size += 1
    return best, best_i, best_j


@njit(cache=True, nogil=True)
def _turned(points: Floats, k: int, offsets: NDArray[np.int32]) -> None:
    """The points in cells, turned by the k-th yaw, in an order in which neighbours are far from each other.

    So a sum over the first of them tells early whether a place can be any good.
    """
    cos, sin = math.cos(k * 2.0 * math.pi / YAWS), math.sin(k * 2.0 * math.pi / YAWS)
    count = points.shape[0]
    for n in range(count):
        m = n * STRIDE % count
        offsets[n, 0] = math.floor(0.5 + sin * points[m, 0] + cos * points[m, 1])
        offsets[n, 1] = math.floor(0.5 + cos * points[m, 0] - sin * points[m, 1])


@njit(cache=True, nogil=True)
def _search(log_odds: NDArray[np.int8], points: Floats, nearly: float) -> Floats:
    """(n, 4) score, row, column, yaw index: the best place of each coarse cell and yaw that does nearly as well."""
    height, width = log_odds.shape
    margin = (1 << LEVELS) + REACH_CELLS  # a bound may count cells before the map's first that are near a wall
    levels = _pyramid(log_odds, margin)
    step = 1 << LEVELS
    up, right = (height + step - 1) // step, (width + step - 1) // step
    bounds = np.empty(YAWS * up * right, np.float32)
    offsets = np.empty((points.shape[0], 2), np.int32)
    for k in range(YAWS):
        _turned(points, k, offsets)
        for i in range(up):
            for j in range(right):
                bounds[(k * up + i) * right + j] = _score(
                    levels, LEVELS, margin, step * i, step * j, offsets, SCORE_MIN * BEST
                )
    # The most promising first: what they score rules out the others.
    order = np.argsort(-bounds, kind="stable")
    found = np.empty((NODES_MAX, 4))
    size = 0
    best = 0.0
    for node in order:
        least = max(SCORE_MIN * BEST, nearly * best)
        if bounds[node] < least or size == NODES_MAX:
            break
        k, i, j = node // (up * right), node // right % up, node % right
        _turned(points, k, offsets)
        score, row, column = _best_leaf(levels, log_odds, margin, step * i, step * j, offsets, least)
        if score >= least:
            best = max(best, score)
            found[size, 0], found[size, 1], found[size, 2], found[size, 3] = score, row, column, k
            size += 1
    return found[:size]
