"""Where robots stand that are to be at one place at once: around it, apart, and on free floor."""

import itertools
import math

import numpy as np
import pytest

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.coordinator.planning.coalition import ROOM_M, spots_around
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry

PLACE = Point2D(4.0, 3.0)


def floor(value=FREE):
    """8 m by 6 m, a tenth of a metre a cell."""
    grid = OccupancyGrid(GridGeometry(0.1, 0.0, 0.0, 80, 60))
    grid.merge_patch(0, 0, np.full((60, 80), value, np.int8), 1)
    return grid


def put(grid, x_m, y_m, width_m, height_m, value):
    rows, columns = round(height_m / 0.1), round(width_m / 0.1)
    grid.merge_patch(round(y_m / 0.1), round(x_m / 0.1), np.full((rows, columns), value, np.int8), 2)
    return grid


def distance_m(one, other):
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m)


def test_one_robot_stands_at_the_place():
    assert spots_around(PLACE, 1, 0.3, None) == [PLACE]


@pytest.mark.parametrize("robots", [2, 3, 6])
def test_spots_lie_evenly_on_a_ring_with_room_between_the_robots(robots):
    spots = spots_around(PLACE, robots, 0.2, None)
    assert len(spots) == robots
    ring_m = distance_m(spots[0], PLACE)
    assert [distance_m(spot, PLACE) for spot in spots] == pytest.approx([ring_m] * robots, abs=2e-3)
    between_m = [distance_m(one, other) for one, other in itertools.pairwise([*spots, spots[0]])]
    assert between_m == pytest.approx([0.4 + ROOM_M] * robots, abs=2e-3)


def test_a_robot_may_touch_the_edge_of_the_map():
    """Which has two cells on each side of a robot of 0.2 m."""
    south = Point2D(4.0, 0.25)
    assert spots_around(south, 2, 0.2, floor()) == spots_around(south, 2, 0.2, None)
    west = spots_around(Point2D(0.25, 3.0), 2, 0.2, floor())
    assert min(spot.x_m for spot in west) > 0.2


def is_free(grid, x_m, y_m):
    """Whether a robot of 0.2 m stands there on free floor."""
    row, column = grid.geometry.cell_of(x_m, y_m)
    return bool((grid.log_odds[row - 2 : row + 3, column - 2 : column + 3] < 0).all())


@pytest.mark.parametrize("value", [OCCUPIED, UNKNOWN])
def test_the_ring_is_turned_no_farther_than_until_its_spots_are_on_free_floor(value):
    if value == OCCUPIED:
        grid = put(floor(), 4.4, 2.4, 1.0, 1.0, OCCUPIED)
    else:
        grid = put(floor(UNKNOWN), 3.7, 1.0, 0.7, 4.0, FREE)  # a lane from south to north
    north, south = spots_around(PLACE, 2, 0.2, grid)
    assert is_free(grid, north.x_m, north.y_m)
    assert is_free(grid, south.x_m, south.y_m)
    assert north.y_m > PLACE.y_m > south.y_m
    before_rad = math.atan2(north.y_m - PLACE.y_m, north.x_m - PLACE.x_m) - math.tau / 48  # one step less
    x_m, y_m = 0.35 * math.cos(before_rad), 0.35 * math.sin(before_rad)
    assert not (is_free(grid, PLACE.x_m + x_m, PLACE.y_m + y_m) and is_free(grid, PLACE.x_m - x_m, PLACE.y_m - y_m))


def test_a_robot_as_wide_as_the_lane_does_not_fit_beside_its_middle():
    """In cells: 0.2 m are two on each side, so a lane of five has one place across."""
    for columns, fits in ((5, True), (4, False)):
        grid = put(floor(UNKNOWN), 3.8, 1.0, columns * 0.1, 4.0, FREE)
        spots = spots_around(Point2D(4.05, 3.05), 2, 0.2, grid)
        columns_of = [grid.geometry.cell_of(spot.x_m, spot.y_m)[1] for spot in spots]
        assert (columns_of == [40, 40]) is fits
