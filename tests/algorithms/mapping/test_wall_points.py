"""Walls of a map as points."""

import numpy as np
import pytest

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.slam.map_overlap import is_same_place, some_points, wall_points
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN
from tests.algorithms.slam.test_map_overlap import WIDE


def test_the_middles_of_occupied_cells_are_the_points():
    grid = OccupancyGrid(WIDE)
    grid.merge_patch(100, 120, np.array([[OCCUPIED, FREE], [UNKNOWN, OCCUPIED]], np.int8), 10)
    assert wall_points(grid) == pytest.approx(np.array([(0.05, -1.95), (0.15, -1.85)]))


@pytest.mark.parametrize(("count", "kept"), [(1, [0]), (3, [0, 4, 9]), (10, list(range(10))), (99, list(range(10)))])
def test_some_points_are_spread_over_all(count, kept):
    points = np.arange(20.0).reshape(10, 2)
    assert (some_points(points, count)[:, 0] / 2).tolist() == kept


@pytest.mark.parametrize(
    ("place", "is_same"),
    [
        (Pose2D(0.49, 0.0, 0.0), True),
        (Pose2D(0.51, 0.0, 0.0), False),
        (Pose2D(0.0, 0.0, 0.19), True),
        (Pose2D(0.0, 0.0, -0.21), False),
        (Pose2D(0.0, 0.0, 2 * np.pi), True),
    ],
)
def test_places_that_differ_little_are_one(place, is_same):
    assert is_same_place(IDENTITY, place) == is_same
