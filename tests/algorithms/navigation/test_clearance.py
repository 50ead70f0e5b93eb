import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.navigation.clearance import least_clearance_m, least_gap_m, mapped_clearance_m
from robrain.algorithms.navigation.navigation_grid import NavigationGrid
from robrain.algorithms.navigation.path_planning import plan_path
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry


def test_a_robot_of_forty_centimetres_drives_through_forty_four():
    assert least_gap_m(0.2) == pytest.approx(0.44)
    assert least_clearance_m(0.2) == pytest.approx(0.22)


@given(
    radius_m=st.floats(0.1, 0.4),
    wider_m=st.floats(0.0, 0.2),
    offset=st.floats(0.0, 1.0),
    resolution_m=st.sampled_from([0.05, 0.1]),
)
def test_no_gap_that_can_be_driven_is_missing_from_a_map(radius_m, wider_m, offset, resolution_m):
    """A corridor whose walls are not aligned with the cells; the cells that contain them are occupied."""
    low_m = (10 + offset) * resolution_m
    high_m = low_m + least_gap_m(radius_m) + wider_m
    classes = np.full((60, 60), FREE, np.int8)
    classes[: math.floor(low_m / resolution_m) + 1] = OCCUPIED
    classes[math.floor(high_m / resolution_m) :] = OCCUPIED
    grid = NavigationGrid(
        classes, GridGeometry(resolution_m, 0.0, 0.0, 60, 60), mapped_clearance_m(radius_m, resolution_m)
    )
    row = int(np.flatnonzero(grid.traversable[:, 30])[0])
    assert plan_path(grid.traversable, grid.cost, (row, 20), (row, 40)) is not None
