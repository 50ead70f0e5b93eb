import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.model.obstacles import contact_distance_m, sector_distances_m

COORDINATES = st.floats(-5, 5)
POINTS = st.lists(st.tuples(COORDINATES, COORDINATES), min_size=1, max_size=20).map(
    lambda points: np.array(points).T.copy()
)


def test_nothing_around_is_nothing_to_touch():
    assert contact_distance_m(np.empty((2, 0)), 0.0, 0.0, 0.0, 0.2) == math.inf
    assert np.isinf(sector_distances_m(np.empty((2, 0)), 0.0, 0.0, 0.0, 8)).all()


@pytest.mark.parametrize(
    ("point", "distance_m"),
    [
        ((1.0, 0.0), 0.8),  # straight ahead
        ((1.0, 0.12), 1.0 - 0.16),  # a little aside: 0.2² = 0.12² + 0.16²
        ((1.0, 0.2), math.inf),  # just passed
        ((-1.0, 0.0), math.inf),  # behind
        ((0.1, 0.0), -0.1),  # already in the disc
    ],
)
def test_a_disc_stops_where_it_touches_a_point(point, distance_m):
    points_m = np.array([[point[0]], [point[1]]])
    assert contact_distance_m(points_m, 0.0, 0.0, 0.0, 0.2) == pytest.approx(distance_m)


@given(POINTS, COORDINATES, COORDINATES, st.floats(-4, 4))
def test_a_disc_that_goes_so_far_touches_and_holds_no_point_in_its_way(points_m, x_m, y_m, heading_rad):
    way_m = contact_distance_m(points_m, x_m, y_m, heading_rad, 0.2)
    if math.isinf(way_m):
        return
    there = np.array([[x_m + way_m * math.cos(heading_rad)], [y_m + way_m * math.sin(heading_rad)]])
    assert np.hypot(*(points_m - there)).min() < 0.2 + 1e-6


@given(POINTS, COORDINATES, COORDINATES, st.floats(-4, 4), st.integers(1, 36))
def test_the_nearest_sector_holds_the_nearest_point(points_m, x_m, y_m, yaw_rad, sectors):
    nearest_m = sector_distances_m(points_m, x_m, y_m, yaw_rad, sectors)
    assert nearest_m.shape == (sectors,)
    assert nearest_m.min() == pytest.approx(np.hypot(points_m[0] - x_m, points_m[1] - y_m).min())


def test_sectors_count_counter_clockwise_from_where_the_robot_looks():
    points_m = np.array([[0.0, 0.0, -1.0], [2.0, -3.0, 0.0]])
    nearest_m = sector_distances_m(points_m, 0.0, 0.0, math.pi / 2, 4)
    assert nearest_m.tolist() == [2.0, 1.0, 3.0, math.inf]
