"""An answer found from the walls about a place is put right by all walls, however far they reach."""

import math

import numpy as np
import pytest

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.slam.map_overlap import MapMatcher
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry

GEOMETRY = GridGeometry(0.1, -1.0, -6.0, 400, 160)
LENGTH_M, WIDTH_M = 36.0, 4.0
CRATES = (
    (3.0, 0.5, 3.8, 1.4),
    (7.1, 2.6, 8.3, 3.4),
    (15.2, 1.0, 15.9, 1.7),
    (24.0, 2.2, 25.1, 3.9),
    (31.0, 0.3, 31.6, 2.0),
)


def hall(T_map_floor: Pose2D) -> OccupancyGrid:
    """A hall of 36 × 4 m with crates, on a map in which the floor lies so."""
    rows, columns = np.indices(GEOMETRY.shape)
    x = GEOMETRY.origin_x_m + (columns + 0.5) * 0.1 - T_map_floor.x_m
    y = GEOMETRY.origin_y_m + (rows + 0.5) * 0.1 - T_map_floor.y_m
    cos, sin = math.cos(T_map_floor.yaw_rad), math.sin(T_map_floor.yaw_rad)
    x, y = cos * x + sin * y, cos * y - sin * x
    is_inside = (x > 0.0) & (x < LENGTH_M) & (y > 0.0) & (y < WIDTH_M)
    is_wall = (x < 0.15) | (x > LENGTH_M - 0.15) | (y < 0.15) | (y > WIDTH_M - 0.15)
    for x0, y0, x1, y1 in CRATES:
        is_wall |= (x > x0) & (x < x1) & (y > y0) & (y < y1)
    grid = OccupancyGrid(GEOMETRY)
    classes = np.where(is_inside, np.where(is_wall, OCCUPIED, FREE), UNKNOWN).astype(np.int8)
    grid.merge_patch(0, 0, classes, 5)
    return grid


TEAM = hall(IDENTITY)


@pytest.mark.parametrize("turn_rad", [0.07, -0.05, 0.031])
@pytest.mark.parametrize("x_m", [5.0, 30.0])
def test_an_answer_is_right_at_the_far_end_of_a_long_hall_too(turn_rad: float, x_m: float) -> None:
    T_own_floor = Pose2D(0.3, -0.4, turn_rad)
    matcher = MapMatcher(hall(T_own_floor), TEAM)
    found = matcher.find(T_own_floor.compose(Pose2D(x_m, 2.0, 0.0)))
    assert found is not None
    for end in (Pose2D(1.0, 2.0, 0.0), Pose2D(35.0, 2.0, 0.0)):
        assert found.T_other_own.compose(T_own_floor.compose(end)).distance_m(end) < 0.05
    assert found.overlap == matcher.overlap(found.T_other_own)


SMALL = GridGeometry(0.1, -2.0, 1.0, 40, 40)


def floor_with_wall(row: int, column: int, *, upright: bool) -> OccupancyGrid:
    """Floor with a wall of four cells."""
    classes = np.full(SMALL.shape, FREE, np.int8)
    for n in range(4):
        classes[row + n * upright, column + n * (not upright)] = OCCUPIED
    grid = OccupancyGrid(SMALL)
    grid.merge_patch(0, 0, classes, 5)
    return grid


@pytest.mark.parametrize("away", [-3, -2, -1, 0, 1, 2, 3])
@pytest.mark.parametrize("upright", [True, False])
def test_walls_up_to_two_cells_apart_are_the_same_wall_on_whichever_side_they_lie(away: int, upright: bool) -> None:
    own = floor_with_wall(18, 18, upright=upright)
    other = floor_with_wall(18 + away * (not upright), 18 + away * upright, upright=upright)
    overlap = MapMatcher(own, other).overlap(IDENTITY)
    if abs(away) <= 2:
        assert (overlap.agreeing, overlap.contradicting) == (4, 0)
    else:
        assert (overlap.agreeing, overlap.contradicting) == (0, 8)
