"""Draws the floor of the scenario `cave`: `python examples/maps/draw_cave.py` writes picture and YAML again.

A cellular automaton draws the rock (Johnson, Yannakakis and Togelius, *Cellular automata for real-time generation of
infinite cave levels*, PCG 2010): in random noise, a cell becomes rock if most of its neighbours are rock.
Chambers are cleared beforehand and joined by winding galleries. Areas that a robot cannot reach are rock.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

FOLDER = Path(__file__).parents[2] / "sim" / "scenarios"
SEED = 9
WIDTH_M, HEIGHT_M, RESOLUTION_M = 36.0, 24.0, 0.05
CELL_M = 0.4
"""Cell of the automaton."""
ROCK_SHARE, STEPS = 0.42, 6
ROCK_OF_NINE = 4
"""A cell becomes rock if at least this number of cells among it and its eight neighbours are rock."""
ROBOT_M = 0.35
"""Radius of a disc that must reach every part: a robot with some clearance."""
CHAMBERS = ((5.0, 5.5, 2.21), (14.5, 4.5, 1.7), (25.5, 5.5, 2.55), (31.5, 12.5, 2.04), (26.0, 19.0, 2.38),
            (15.5, 18.5, 2.72), (5.5, 17.5, 2.21), (16.5, 11.5, 1.53))  # fmt: skip
"""x, y and radius of the chambers, metres."""
GALLERIES = ((0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 6), (6, 0), (1, 7), (7, 5), (7, 3))
"""Pairs of chambers that are joined."""
GALLERY_M = 0.55
"""Half the width of a gallery before the automaton."""
YAML = """\
# A cave of 36 × 24 m; drawn for this project by examples/maps/draw_cave.py, under its licence.
image: cave.png
resolution: 0.05
origin: [0.0, 0.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""


def cave() -> NDArray[np.bool_]:
    """Rock of the cave: (H, W), row 0 at the lowest y."""
    rng = np.random.default_rng(SEED)
    rows, columns = round(HEIGHT_M / CELL_M), round(WIDTH_M / CELL_M)
    y_m, x_m = np.meshgrid((np.arange(rows) + 0.5) * CELL_M, (np.arange(columns) + 0.5) * CELL_M, indexing="ij")
    hollow = np.zeros((rows, columns), np.bool_)
    for chamber_x_m, chamber_y_m, radius_m in CHAMBERS:
        hollow |= np.hypot(x_m - chamber_x_m, y_m - chamber_y_m) < radius_m
    for one, other in GALLERIES:
        hollow |= _gallery(CHAMBERS[one][:2], CHAMBERS[other][:2], x_m, y_m, rng)
    rock = (rng.random((rows, columns)) < ROCK_SHARE) & ~hollow
    near_edge = np.minimum(np.minimum(x_m, WIDTH_M - x_m), np.minimum(y_m, HEIGHT_M - y_m)) < 1.2 * CELL_M
    for _ in range(STEPS):
        rock |= near_edge
        neighbours = ndimage.convolve(rock.astype(np.int64), np.ones((3, 3), np.int64), mode="constant", cval=1)
        rock = (neighbours >= ROCK_OF_NINE) & ~hollow
    rock |= near_edge
    return _smooth(rock)


def _gallery(
    one: tuple[float, float],
    other: tuple[float, float],
    x_m: NDArray[np.float64],
    y_m: NDArray[np.float64],
    rng: np.random.Generator,
) -> NDArray[np.bool_]:
    """A winding path between two places."""
    share = np.linspace(0.0, 1.0, 60)
    sway_m = 1.3 * np.sin(np.pi * share) * np.sin(2 * np.pi * (share * rng.uniform(1.0, 1.8) + rng.uniform()))
    off = np.array(other) - np.array(one)
    across = np.array([-off[1], off[0]]) / np.hypot(*off)
    middle = np.array(one) + share[:, None] * off + sway_m[:, None] * across
    distance_m = np.min([np.hypot(x_m - at_x_m, y_m - at_y_m) for at_x_m, at_y_m in middle], axis=0)
    return np.asarray(distance_m < GALLERY_M)


def _smooth(rock: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The rock in the cells of the map, with rounded sides; areas that a robot cannot reach are rock."""
    scale = round(CELL_M / RESOLUTION_M)
    fine = ndimage.gaussian_filter(np.kron(rock, np.ones((scale, scale))), 0.6 * scale) > 0.5
    room = ndimage.distance_transform_edt(~fine) * RESOLUTION_M
    regions, _ = ndimage.label(room > ROBOT_M)
    largest = regions == np.bincount(regions.ravel())[1:].argmax() + 1
    reached = ndimage.distance_transform_edt(~largest) * RESOLUTION_M <= ROBOT_M
    return np.asarray(~reached | fine)


def main() -> None:
    """Write picture and YAML beside the scenario."""
    picture = Image.fromarray(np.where(cave(), 0, 254).astype(np.uint8)[::-1])
    picture.save(FOLDER / "cave.png", optimize=True, bits=8)
    (FOLDER / "cave.yaml").write_text(YAML, encoding="utf-8")


if __name__ == "__main__":
    main()
