"""Finding a robot again by what its lidar sees, anywhere on a map, with no idea of where it was.

All places of the known floor, 0.2 m and 5° apart, are scored by the distance of the beams' ends from the nearest wall
(the likelihood field of Thrun, Burgard, Fox, *Probabilistic Robotics*, section 6.4); the best are refined and held
against the map beam by beam. Rooms look alike, so an answer counts only if no other place does nearly as well.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.occupancy_grid import GridGeometry
from robrain.protocol.model.scan_match import REACH_M, match_scan
from robrain.protocol.model.scan_match_kernels import distance_window
from robrain.protocol.model.small_linear_algebra import least_solution

STEP_CELLS = 2
YAWS = 72
REACH_CELLS = 4
BEAMS = 60
"""Of a scan, so many are enough to score places."""
CANDIDATES = 24
COMPARED_MIN = 0.5
"""Share of a scan's beams that must end where the map is known; chosen, as are the other figures here."""
AGREES = 0.85
"""Share of the compared beams that must be as the map says …"""
LEAD = 0.1
"""… and by so much more than at any other place."""
APART_M, APART_RAD = 0.5, 0.25
"""Nearer than this is not another place."""
NEAR_CELLS = 2.0
BODY_M = 0.5
"""Nearer than this the map may show the robot itself, as the others saw it."""
NEAR_M = 0.2
"""Reach of the last refinement, metres: a longer one would pull beams at unmapped walls to other walls."""
SHORT_M = 0.3
"""A beam may end this far behind a wall of the map before it has gone through it."""


def agreement(
    log_odds: NDArray[np.int8], geometry: GridGeometry, sensor: Pose2D, points: NDArray[np.float64]
) -> tuple[float, int]:
    """Share of a scan's beams that are as the map says, seen from `sensor` (arena frame), and how many were compared.

    `points` (K, 2) are the beams' ends in the sensor's frame, see `beam_ends`. A beam agrees that ends at a wall of the
    map and goes through none. Beams that end where nothing is known are not compared.
    """
    agreeing, compared = _agreement(
        log_odds,
        1.0 / geometry.resolution_m,
        (sensor.x_m - geometry.origin_x_m) / geometry.resolution_m,
        (sensor.y_m - geometry.origin_y_m) / geometry.resolution_m,
        sensor.yaw_rad,
        points,
        BODY_M,
        SHORT_M,
        NEAR_CELLS,
    )
    return agreeing / max(compared, 1), compared


def find_by_scan(log_odds: NDArray[np.int8], geometry: GridGeometry, points: NDArray[np.float64]) -> Pose2D | None:
    """T_arena_sensor; None if the scan fits nowhere, or in more than one place.

    Arguments are those of `agreement`.
    """
    rows, columns = np.flatnonzero((log_odds != 0).any(axis=1)), np.flatnonzero((log_odds != 0).any(axis=0))
    if len(points) < BEAMS // 2 or rows.size == 0:
        return None
    row, column = int(rows[0]), int(columns[0])
    height, width = int(rows[-1]) - row + 1, int(columns[-1]) - column + 1
    field = distance_window(log_odds, row, column, height, width, REACH_CELLS)
    beams = points[np.linspace(0, len(points) - 1, min(BEAMS, len(points))).astype(np.int64)] / geometry.resolution_m
    scores = _scores(np.ascontiguousarray(log_odds[row : row + height, column : column + width]), field, beams)
    found: list[tuple[float, Pose2D]] = []
    for _ in range(CANDIDATES):
        i, j, k = (int(index) for index in np.unravel_index(int(scores.argmax()), scores.shape))
        if scores[i, j, k] <= 0:
            break
        around = np.arange(k - 2, k + 3) % YAWS
        scores[max(i - 2, 0) : i + 3, max(j - 2, 0) : j + 3, around] = 0
        middle = geometry.center_of(row + STEP_CELLS * i, column + STEP_CELLS * j)
        pose = _refined(log_odds, geometry, Pose2D(middle.x_m, middle.y_m, k * math.tau / YAWS), points)
        share, compared = agreement(log_odds, geometry, pose, points)
        if compared >= COMPARED_MIN * len(points):
            found.append((share, pose))
    if not found:
        return None
    best_share, best = max(found, key=lambda each: each[0])
    others = [share for share, pose in found if _is_apart(pose, best)]
    return best if best_share >= AGREES and max(others, default=0.0) <= best_share - LEAD else None


def _refined(log_odds: NDArray[np.int8], geometry: GridGeometry, guess: Pose2D, points: NDArray[np.float64]) -> Pose2D:
    for reach_m in (REACH_M, REACH_M, NEAR_M):
        held = match_scan(log_odds, geometry, guess, points, reach_m).directions
        if not held:
            return guess
        rows, offsets_m = np.array([each.row for each in held]), np.array([each.offset_m for each in held])
        x_m, y_m, yaw_rad = least_solution(rows, offsets_m).tolist()
        guess = Pose2D(guess.x_m + x_m, guess.y_m + y_m, math.remainder(guess.yaw_rad + yaw_rad, math.tau))
    return guess


def _is_apart(one: Pose2D, other: Pose2D) -> bool:
    turn_rad = math.remainder(one.yaw_rad - other.yaw_rad, math.tau)
    return one.distance_m(other) > APART_M or abs(turn_rad) > APART_RAD


@njit(cache=True, nogil=True)
def _scores(log_odds: NDArray[np.int8], field: NDArray[np.float32], beams: NDArray[np.float64]) -> NDArray[np.float32]:
    """(I, J, YAWS): mean nearness to a wall of the beams' ends, for each `STEP_CELLS`th cell that is free."""
    height, width = log_odds.shape
    scores = np.zeros(
        ((height + STEP_CELLS - 1) // STEP_CELLS, (width + STEP_CELLS - 1) // STEP_CELLS, YAWS), np.float32
    )
    count = beams.shape[0]
    turned = np.empty((count, 2))
    for k in range(YAWS):
        cos, sin = math.cos(k * 2.0 * math.pi / YAWS), math.sin(k * 2.0 * math.pi / YAWS)
        for n in range(count):
            turned[n, 0] = cos * beams[n, 0] - sin * beams[n, 1] + 0.5
            turned[n, 1] = sin * beams[n, 0] + cos * beams[n, 1] + 0.5
        for i in range(scores.shape[0]):
            for j in range(scores.shape[1]):
                if log_odds[STEP_CELLS * i, STEP_CELLS * j] >= 0:
                    continue
                total = 0.0
                for n in range(count):
                    column = math.floor(STEP_CELLS * j + turned[n, 0])
                    row = math.floor(STEP_CELLS * i + turned[n, 1])
                    if 0 <= row < height and 0 <= column < width:
                        total += 1.0 - field[row, column] / REACH_CELLS
                    if n == count // 3 and total < 0.25 * n:
                        total = 0.0
                        break
                scores[i, j, k] = total / count
    return scores


@njit(cache=True, nogil=True)
def _agreement(
    log_odds: NDArray[np.int8],
    per_m: float,
    x: float,
    y: float,
    yaw_rad: float,
    points: NDArray[np.float64],
    body_m: float,
    short_m: float,
    near_cells: float,
) -> tuple[int, int]:
    """Beams that agree, and beams compared; `x` and `y` in cells."""
    height, width = log_odds.shape
    around = math.ceil(near_cells)
    agreeing, compared = 0, 0
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    for k in range(points.shape[0]):
        out_x = per_m * (cos * points[k, 0] - sin * points[k, 1])
        out_y = per_m * (sin * points[k, 0] + cos * points[k, 1])
        way = math.hypot(out_x, out_y)
        is_blocked = False
        at = body_m * per_m
        while at < way - short_m * per_m and not is_blocked:
            row, column = math.floor(y + out_y * at / way), math.floor(x + out_x * at / way)
            is_blocked = 0 <= row < height and 0 <= column < width and log_odds[row, column] > 0
            at += 1.0
        row, column = math.floor(y + out_y), math.floor(x + out_x)
        is_near = False
        for i in range(max(row - around, 0), min(row + around + 1, height)):
            for j in range(max(column - around, 0), min(column + around + 1, width)):
                if log_odds[i, j] > 0 and math.hypot(i - row, j - column) <= near_cells:
                    is_near = True
        is_known = 0 <= row < height and 0 <= column < width and log_odds[row, column] != 0
        if is_near or is_blocked or is_known:
            compared += 1
            agreeing += is_near and not is_blocked
    return agreeing, compared
