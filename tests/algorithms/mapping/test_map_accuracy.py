"""Accuracy of a map: cells off the true walls, and walls that are on the map twice."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.localization.scan_match import without_dropouts
from robrain.algorithms.mapping.map_accuracy import OFF_M, measure_map_accuracy
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry

PLAN = GridGeometry(0.05, -1.0, 2.0, 120, 80)
"""The same floor of 6 × 4 m at twice the resolution."""
WALL_COLUMN = 60
"""Of the plan: from x = 2.0 to 2.05 m, thus in the map's column 30."""


def floor(geometry=PLAN, column=WALL_COLUMN):
    """Walls all around, and one across from bottom to top."""
    walls = np.zeros(geometry.shape, np.bool_)
    walls[[0, -1], :] = walls[:, [0, -1]] = True
    if column is not None:
        walls[:, column] = True
    return walls


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.04, 0.1, 0.23]), st.sampled_from([0.0, 0.013, -0.371]))
def test_counts_are_those_of_the_definition(seed, plan_cell_m, shift_m):
    rng = np.random.default_rng(seed)
    geometry = GridGeometry(0.1, 0.0, 0.0, 18, 15)
    plan = GridGeometry(plan_cell_m, shift_m, -shift_m, math.ceil(1.8 / plan_cell_m), math.ceil(1.5 / plan_cell_m))
    classes = rng.choice(np.array([UNKNOWN, FREE, OCCUPIED]), geometry.shape, p=[0.3, 0.5, 0.2])
    walls = rng.random(plan.shape) < 0.01
    told = measure_map_accuracy(classes, geometry, walls, plan)
    distances_m = {
        (row, column): distance_to_wall_m(geometry.center_of(row, column), walls, plan)
        for row, column in zip(*np.nonzero(classes == OCCUPIED), strict=True)
    }
    slack_m = 1e-5
    off = {cell for cell, distance_m in distances_m.items() if distance_m > OFF_M + slack_m}
    on_wall = [cell for cell, distance_m in distances_m.items() if distance_m <= geometry.resolution_m + slack_m]
    doubled = {cell for cell in off if any(math.dist(cell, other) <= 10 + slack_m for other in on_wall)}
    assert told.occupied_cells == len(distances_m)
    assert told.cells_off == len(off)
    assert told.doubled_walls_m == pytest.approx(0.1 * len(doubled))


def distance_to_wall_m(place, walls, plan):
    """The plain way: over all wall cells, and the plan's edge."""
    x_m, y_m = place.x_m - plan.origin_x_m, place.y_m - plan.origin_y_m
    width_m, height_m = plan.width * plan.resolution_m, plan.height * plan.resolution_m
    least_m = max(0.0, min(x_m, y_m, width_m - x_m, height_m - y_m))
    for row, column in zip(*np.nonzero(walls), strict=True):
        low_x_m, low_y_m = column * plan.resolution_m, row * plan.resolution_m
        dx_m = max(low_x_m - x_m, x_m - low_x_m - plan.resolution_m, 0.0)
        dy_m = max(low_y_m - y_m, y_m - low_y_m - plan.resolution_m, 0.0)
        least_m = min(least_m, math.hypot(dx_m, dy_m))
    return least_m


BEAMS = 12


def ranges(*missed, miss_m=6.0):
    ranges_m = np.full(BEAMS, 2.0)
    ranges_m[list(missed)] = miss_m
    return ranges_m


@pytest.mark.parametrize("miss_m", [6.0, 7.5, math.inf, math.nan])
@pytest.mark.parametrize(
    ("missed", "dropped"),
    [
        ((), []),
        ((5,), [5]),
        ((3, 5), [3, 5]),
        ((4, 5, 6), [4, 5, 6]),
        ((4, 5, 6, 7), []),
        ((4, 5, 6, 7, 8), []),
        ((1, 4, 5, 6, 7), [1]),
        ((0, 11), [0, 11]),
        ((0, 1, 10, 11), []),
        (range(BEAMS), []),
    ],
)
def test_fewer_than_four_neighbouring_beams_without_a_return_say_nothing(missed, dropped, miss_m):
    heard_m = without_dropouts(ranges(*missed, miss_m=miss_m), 6.0, 4)
    silent = [beam for beam in range(BEAMS) if math.isnan(heard_m[beam])]
    assert silent == (sorted(missed) if math.isnan(miss_m) else dropped)
