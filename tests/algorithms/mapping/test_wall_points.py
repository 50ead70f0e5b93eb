"""Walls of a map as points."""

import numpy as np
import pytest

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.slam.map_overlap import wall_points
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN
from tests.algorithms.slam.test_map_overlap import WIDE


def test_the_middles_of_occupied_cells_are_the_points():
    grid = OccupancyGrid(WIDE)
    grid.merge_patch(100, 120, np.array([[OCCUPIED, FREE], [UNKNOWN, OCCUPIED]], np.int8), 10)
    assert wall_points(grid) == pytest.approx(np.array([(0.05, -1.95), (0.15, -1.85)]))
