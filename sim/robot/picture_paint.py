"""What things in a simulated camera's picture are painted with: chosen, so that places are told apart.

Walls have a colour by region, joints, a skirting and here and there a poster; all by place, so that a wall looks the
same whenever it is seen.
"""

import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.numeric.elementary_functions import arctan2

Rgb = tuple[int, int, int]

ROBOT_COLORS = np.array(
    [
        (230, 159, 0),
        (86, 180, 233),
        (0, 158, 115),
        (204, 121, 167),
        (213, 94, 0),
        (240, 228, 66),
        (0, 114, 178),
        (170, 170, 170),
    ],
    np.float64,
)
"""The colours of Okabe and Ito, Color Universal Design (2008), in which the dashboard shows robots too."""
ROBOT_BAND = np.array((245.0, 245.0, 245.0))
ROBOT_DARK = np.array((28.0, 28.0, 32.0))
CEILING = np.array((205.0, 205.0, 198.0))
MOTE_POST = np.array((200.0, 40.0, 160.0))
PLATE = np.array((255.0, 250.0, 120.0))
PLATE_INK = np.array((10.0, 10.0, 10.0))

CHARGER_RADIUS_M, CHARGER_INNER_M, CHARGER_BOLT_M = 0.3, 0.2, 0.035
CHARGER_STRIPES = 6
CHARGER_YELLOW = np.array((250.0, 210.0, 0.0))
CHARGER_BLACK = np.array((20.0, 20.0, 20.0))
CHARGER_GREEN = np.array((0.0, 140.0, 70.0))

WALLS = np.array(
    [(196, 188, 170), (170, 186, 196), (188, 200, 172), (204, 178, 168), (182, 176, 200), (200, 196, 160)], np.float64
)
POSTERS = np.array([(180, 60, 50), (50, 90, 160), (60, 130, 70), (200, 150, 50), (110, 70, 130)], np.float64)
REGION_M = 2.5
"""Size of the regions in which walls have one colour."""
BAY_M = 1.25
"""A poster at the most hangs in each bay of a wall."""
JOINT_M = 0.04
SKIRTING_M = 0.09
TILE_M = 0.5

DIGITS = (
    ("###", "#.#", "#.#", "#.#", "###"),
    (".#.", "##.", ".#.", ".#.", "###"),
    ("###", "..#", "###", "#..", "###"),
    ("###", "..#", "###", "..#", "###"),
    ("#.#", "#.#", "###", "..#", "..#"),
    ("###", "#..", "###", "..#", "###"),
    ("###", "#..", "###", "#.#", "###"),
    ("###", "..#", "..#", ".#.", ".#."),
    ("###", "#.#", "###", "#.#", "###"),
    ("###", "#.#", "###", "..#", "###"),
)


def wall_color(
    x_m: NDArray[np.float64], y_m: NDArray[np.float64], along_m: NDArray[np.float64], heights_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Colours (H, W, 3) of the walls at (W,) places, arena frame, (W,) metres along the wall and (H, W) up it."""
    region = _scatter(np.floor(x_m / REGION_M), np.floor(y_m / REGION_M))
    color = np.empty((*heights_m.shape, 3))
    color[:] = WALLS[region % len(WALLS)]
    bay = np.floor(along_m / BAY_M)
    in_bay_m = along_m - BAY_M * bay
    # Offset by a little: what lies on the border of two regions must not change with rounding.
    hangs = _scatter(bay, np.floor((x_m + y_m - along_m) / REGION_M + 1e-6))
    has_poster = (hangs % 5 < 2) & (in_bay_m > 0.25) & (in_bay_m < 1.0)
    poster = has_poster & (heights_m > 0.35) & (heights_m < 1.3)
    frame = poster & ((in_bay_m < 0.3) | (in_bay_m > 0.95) | (heights_m < 0.4) | (heights_m > 1.25))
    color[poster] = np.broadcast_to(POSTERS[hangs // 5 % len(POSTERS)], color.shape)[poster]
    color[frame] = 40.0
    color[np.broadcast_to(in_bay_m < JOINT_M, heights_m.shape)] *= 0.75
    color[heights_m < SKIRTING_M] *= 0.5
    return color


def floor_color(x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colours (N, 3) of the tiled floor at (N,) places, arena frame."""
    even = (np.floor(x_m / TILE_M) + np.floor(y_m / TILE_M)) % 2 == 0
    return np.where(even[:, None], np.array((128.0, 122.0, 112.0)), np.array((108.0, 102.0, 94.0)))


def charger_color(x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Which of (N,) places, metres from a charger's middle, its mat covers, and colours (M, 3) of those.

    A mat, for a robot stands on it: a ring that is yellow and black by turns, within it green with a yellow bolt.
    """
    away_m = np.hypot(x_m, y_m)
    covers = away_m < CHARGER_RADIUS_M
    x_m, y_m, away_m = x_m[covers], y_m[covers], away_m[covers]
    turn = np.floor(arctan2(y_m, x_m) * CHARGER_STRIPES / np.pi)
    color = np.where((turn % 2 == 0)[:, None], CHARGER_YELLOW, CHARGER_BLACK)
    inner = away_m < CHARGER_INNER_M
    bolt = np.abs(x_m + 0.5 * y_m - 0.05 * np.sign(y_m)) < CHARGER_BOLT_M
    color[inner] = np.where(bolt[inner, None], CHARGER_YELLOW, CHARGER_GREEN)
    return covers, color


def number_cells(number: int) -> NDArray[np.bool_]:
    """A number as cells (7, 4·digits + 1), inked ones True, with a blank border."""
    digits = str(number)
    cells = np.zeros((7, 4 * len(digits) + 1), np.bool_)
    for place, digit in enumerate(digits):
        for row, line in enumerate(DIGITS[int(digit)]):
            for column, mark in enumerate(line):
                cells[1 + row, 1 + 4 * place + column] = mark == "#"
    return cells


def _scatter(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.int64]:
    """A whole number that looks random but only depends on these two whole ones."""
    mixed = a.astype(np.int64) * 73856093 ^ b.astype(np.int64) * 19349663
    return (mixed ^ mixed >> 7) & 0x7FFF
