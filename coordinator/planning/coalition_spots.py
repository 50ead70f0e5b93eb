"""Where k robots stand that are to be at one place at once: around it, each with room of its own."""

import math
from typing import TYPE_CHECKING

import numpy as np

from robrain.protocol.model.geometry import Point2D

if TYPE_CHECKING:  # brings the map's kernels, which a coordinator loads when it is up (coordinator/live.py)
    from robrain.protocol.model.mapping.occupancy_grid import OccupancyGrid

ROOM_M = 0.3
"""Between the edges of two robots at their spots (chosen: they give way to each other on less)."""
DIRECTIONS = 24


def spots_around(place: Point2D, robots: int, radius_m: float, grid: "OccupancyGrid | None") -> list[Point2D]:
    """Spots on a ring around a place, evenly spread, turned so that most of them are on floor known to be free.

    Args:
        place: what they are to be at, arena frame.
        robots: how many spots.
        radius_m: of the greatest robot.
        grid: what is known of the floor.

    Returns:
        As many as robots; the place itself if it is one.

    """
    if robots == 1:
        return [place]
    ring_m = (2.0 * radius_m + ROOM_M) / (2.0 * math.sin(math.pi / robots))
    turns = [math.tau * turn / DIRECTIONS / robots for turn in range(DIRECTIONS)]
    rings = [[_on_ring(place, ring_m, turn + math.tau * k / robots) for k in range(robots)] for turn in turns]
    return max(rings, key=lambda ring: sum(_is_free(spot, radius_m, grid) for spot in ring))


def _on_ring(place: Point2D, ring_m: float, angle_rad: float) -> Point2D:
    return Point2D(
        round(place.x_m + ring_m * math.cos(angle_rad), 3), round(place.y_m + ring_m * math.sin(angle_rad), 3)
    )  # fmt: skip


def _is_free(spot: Point2D, radius_m: float, grid: "OccupancyGrid | None") -> bool:
    if grid is None:
        return True
    row, column = grid.geometry.cell_of(spot.x_m, spot.y_m)
    reach = math.ceil(radius_m / grid.geometry.resolution_m)
    box = grid.log_odds[max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1]
    return box.shape == (2 * reach + 1, 2 * reach + 1) and bool(np.all(box < 0))
