import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.navigation.obstacles import Passage, contact_distance_m, hold_off, passage, sector_distances_m

COORDINATES = st.floats(-5, 5)
POINTS = st.lists(st.tuples(COORDINATES, COORDINATES), min_size=1, max_size=20).map(
    lambda points: np.array(points).T.copy()
)


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
    path_m = contact_distance_m(points_m, x_m, y_m, heading_rad, 0.2)
    if math.isinf(path_m):
        return
    there = np.array([[x_m + path_m * math.cos(heading_rad)], [y_m + path_m * math.sin(heading_rad)]])
    assert np.hypot(*(points_m - there)).min() < 0.2 + 1e-6


@given(POINTS, COORDINATES, COORDINATES, st.floats(-4, 4), st.integers(1, 36))
def test_the_nearest_sector_holds_the_nearest_point(points_m, x_m, y_m, yaw_rad, sectors):
    nearest_m = sector_distances_m(points_m, x_m, y_m, yaw_rad, sectors)
    assert len(nearest_m) == sectors
    assert min(nearest_m) == pytest.approx(np.hypot(points_m[0] - x_m, points_m[1] - y_m).min())


def test_sectors_count_counter_clockwise_from_where_the_robot_looks():
    points_m = np.array([[0.0, 0.0, -1.0], [2.0, -3.0, 0.0]])
    nearest_m = sector_distances_m(points_m, 0.0, 0.0, math.pi / 2, 4)
    assert nearest_m == [2.0, 1.0, 3.0, math.inf]


def test_towards_something_near_a_disc_goes_no_faster_than_what_is_left_allows():
    ahead = np.array([[0.3], [0.0]])
    assert hold_off(ahead, 0.0, 0.0, 0.5, 0.0, 0.2, 0.01, 1.5) == pytest.approx((1.5 * 0.09, 0.0))
    assert hold_off(ahead, 0.0, 0.0, -0.5, 0.2, 0.2, 0.01, 1.5) == (-0.5, 0.2)


def test_along_a_wall_a_disc_goes_as_it_likes_and_from_one_too_near_it_is_pushed_away():
    beside = np.array([[0.0], [0.205]])
    assert hold_off(beside, 0.0, 0.0, 0.3, 0.0, 0.2, 0.01, 1.5) == pytest.approx((0.3, -1.5 * 0.005))


@given(POINTS, st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
def test_what_is_far_from_the_hull_changes_nothing(points_m, x_m_s, y_m_s):
    away = points_m[:, np.hypot(*points_m) > 0.41]
    assert hold_off(np.ascontiguousarray(away), 0.0, 0.0, x_m_s, y_m_s, 0.2, 0.01, 1.5) == (x_m_s, y_m_s)


def plain_passage(points_m: np.ndarray, x_m: float, y_m: float, heading_rad: float, radius_m: float) -> Passage:
    """The docstrings' rules: a hull's contact takes three points, or one that overlaps by more than 3 cm."""
    towards = np.exp(-1j * heading_rad) * ((points_m[0] - x_m) + 1j * (points_m[1] - y_m))
    seen = [(float(point.real), float(point.imag)) for point in towards]

    def contacts_m(disc_m: float) -> list[float]:
        within = [(ahead_m, aside_m) for ahead_m, aside_m in seen if ahead_m > 0.0 and abs(aside_m) < disc_m]
        return sorted(ahead_m - math.sqrt(disc_m**2 - aside_m**2) for ahead_m, aside_m in within)

    def third(distances_m: list[float]) -> float:
        return sorted(distances_m)[2] if len(distances_m) > 2 else math.inf

    free_m = min(third(contacts_m(radius_m)), min(contacts_m(radius_m - 0.03), default=math.inf))
    until_m = min(0.4, radius_m + max(0.0, free_m) - 0.05)
    beside_m = [aside_m for ahead_m, aside_m in seen if -0.15 < ahead_m < until_m and abs(aside_m) > 0.5 * radius_m]
    left_m = third([aside_m for aside_m in beside_m if aside_m > 0.0])
    return Passage(free_m, left_m, third([-aside_m for aside_m in beside_m if aside_m < 0.0]))


def test_passage_is_what_its_rules_say_for_any_points() -> None:
    draw = np.random.default_rng(8)
    found = []
    for _ in range(300):
        x_m, y_m, heading_rad = draw.uniform(-4.0, 4.0, 3)
        count = int(draw.integers(1, 40))
        ahead_m, aside_m = draw.uniform(-0.3, 0.6, count), draw.normal(0.0, 0.3, count)
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        points_m = np.stack((x_m + cos * ahead_m - sin * aside_m, y_m + sin * ahead_m + cos * aside_m))
        found.append(passage(points_m, x_m, y_m, heading_rad, 0.2))
        assert found[-1] == pytest.approx(plain_passage(points_m, x_m, y_m, heading_rad, 0.2), abs=1e-9)
    assert all(50 < sum(map(math.isfinite, column)) < 290 for column in zip(*found, strict=True))


def lists(points_m: np.ndarray) -> tuple[list[float], list[float]]:
    """The points as a robot without arrays has them."""
    x_m, y_m = points_m.tolist()
    return x_m, y_m


@given(POINTS, COORDINATES, COORDINATES, st.floats(-4, 4), st.floats(0.05, 1.0))
def test_a_robot_without_arrays_finds_the_same_room(points_m, x_m, y_m, heading_rad, reach_m):
    plain = lists(points_m)
    for function in (contact_distance_m, passage):
        assert function(plain, x_m, y_m, heading_rad, reach_m) == function(points_m, x_m, y_m, heading_rad, reach_m)
    sectors = sector_distances_m(points_m, x_m, y_m, heading_rad, 12)
    assert sector_distances_m(plain, x_m, y_m, heading_rad, 12) == pytest.approx(sectors, rel=1e-12)


@given(POINTS, COORDINATES, COORDINATES, st.floats(-1, 1), st.floats(-1, 1))
def test_a_robot_without_arrays_holds_off_as_one_with_arrays_does(points_m, x_m, y_m, x_m_s, y_m_s):
    rest = (x_m, y_m, x_m_s, y_m_s, 0.2, 0.02, 2.0)
    assert hold_off(lists(points_m), *rest) == pytest.approx(hold_off(points_m, *rest), rel=1e-9, abs=1e-9)
