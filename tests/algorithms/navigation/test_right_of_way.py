import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.navigation.right_of_way import STEP_M, DrivenPath, Margins, Track, meet, release, sample_path
from robrain.protocol.model.geometry import Point2D

MARGINS = Margins()
SPEED_M_S = 0.6
KEEP_M = 0.4


def line(x0, y0, x1, y1):
    return sample_path(np.array([(x0, y0), (x1, y1)], float), 100.0)


def track(positions, *, first=True, held_at=None):
    held = positions.shape[0] - 1 if held_at is None else held_at
    return Track(positions, SPEED_M_S, held, KEEP_M, goes_first=first)


OWN = line(0, 0, 8, 0)


def test_with_nobody_there_all_is_released():
    found = release(OWN, SPEED_M_S, [], MARGINS)
    assert (found.positions, found.is_whole, found.must_leave, found.by) == (len(OWN), True, False, -1)


def test_head_on_who_yields_must_leave_and_who_goes_first_drives_on():
    oncoming = line(8, 0, 0, 0)
    yields = release(OWN, SPEED_M_S, [track(oncoming)], MARGINS)
    assert (yields.positions, yields.must_leave, yields.by) == (1, True, 0)
    assert release(OWN, SPEED_M_S, [track(oncoming, first=False)], MARGINS).is_whole  # it is far away yet


def test_nobody_drives_on_into_one_that_stands_whoever_goes_first():
    stands = track(np.array([(1.0, 0.0)]), first=False)
    allowed = release(OWN, SPEED_M_S, [stands], MARGINS)
    assert 1.0 - OWN[allowed.positions - 1][0] >= KEEP_M + MARGINS.guard_m


def test_one_that_is_too_near_may_be_left():
    behind = track(np.array([(-0.3, 0.0)]), first=False)
    assert release(OWN, SPEED_M_S, [behind], MARGINS).is_whole


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), min_size=2, max_size=5),
    st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), min_size=2, max_size=5),
)
def test_two_that_keep_to_what_they_are_released_do_not_touch_in_the_next_seconds(mine, other):
    """Who yields says where it waits; both drive what they may, each on time."""
    mine, other = (sample_path(np.array(points), 10.0) for points in (mine, other))
    if np.hypot(*(mine[0] - other[0])) < KEEP_M + MARGINS.guard_m + 0.1:
        return
    yields = release(other, SPEED_M_S, [track(mine)], MARGINS).positions
    first = release(mine, SPEED_M_S, [track(other, first=False, held_at=yields - 1)], MARGINS).positions
    for k in range(round(MARGINS.guard_s * SPEED_M_S / STEP_M)):
        apart_m = np.hypot(*(mine[min(k, first - 1)] - other[min(k, yields - 1)]))
        assert apart_m >= KEEP_M - 1e-9


def test_ways_that_meet():
    assert meet(OWN, track(line(4, -4, 4, 4)), 0.1)
    assert not meet(OWN, track(line(0, 1, 8, 1)), 0.1)


@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), min_size=1, max_size=6))
def test_positions_lie_a_step_apart_from_the_first_point_to_the_last(points):
    points = np.array(points)
    positions = sample_path(points, 100.0)
    assert positions[0] == pytest.approx(points[0])
    assert np.hypot(*(positions[-1] - points[-1])) <= 0.011
    assert np.all(np.hypot(*np.diff(positions, axis=0).T) <= STEP_M + 1e-9)


def test_a_way_tells_what_lies_ahead_and_takes_no_short_cut_where_it_comes_back():
    there_and_back = DrivenPath(np.array([(0.0, 0.0), (3.0, 0.0), (3.0, 0.3), (0.0, 0.3)]))
    there_and_back.ahead(0.5, 0.15, 10.0)
    assert there_and_back.passed_m == pytest.approx(0.5, abs=0.11)
    for x in np.arange(0.6, 3.0, 0.2):
        ahead = there_and_back.ahead(float(x), 0.0, 10.0)
    assert ahead[0] == pytest.approx((2.8, 0.0))
    assert there_and_back.left_m == pytest.approx(3.5, abs=0.11)
    assert ahead[-1] == pytest.approx((0.0, 0.3), abs=0.11)


def test_the_points_up_to_a_place_end_there():
    way = DrivenPath(np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)]))
    until = way.points_until(1.5)
    assert until[-1] == pytest.approx((1.0, 0.5))
    assert way.points_until(math.inf)[-1] == pytest.approx((1.0, 1.0))


def test_points_until_a_place_leave_out_what_was_passed():
    corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (2.0, 1.0), (2.0, 2.0)]
    way = DrivenPath(np.array(corners))
    for at in ((0.5, 0.0), (1.0, 0.0), (1.0, 0.5)):
        way.ahead(*at, 10.0)
    assert way.points_until(3.5).tolist() == [[1.0, 1.0], [2.0, 1.0], [2.0, 1.5]]
    assert way.points_until(math.inf).tolist() == [list(corner) for corner in corners[2:]]


def test_way_of_one_point_has_no_length_and_ends_there():
    way = DrivenPath(np.array([(1.0, 2.0)]))
    assert (way.length_m, way.left_m, way.end) == (0.0, 0.0, Point2D(1.0, 2.0))
    assert way.points_until(math.inf).tolist() == [[1.0, 2.0]]
    assert way.ahead(1.0, 2.1, 5.0).tolist() == [[1.0, 2.1]]


@pytest.mark.parametrize("limit_m", [0.3, 0.5, 0.7, 1.2])
def test_way_that_is_cut_off_has_a_position_at_the_limit_and_none_beyond(limit_m):
    positions = sample_path(np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)]), limit_m)
    assert positions.shape == (round(limit_m / STEP_M) + 1, 2)
    assert positions.sum(axis=1) == pytest.approx(STEP_M * np.arange(len(positions)))


def test_end_of_a_way_is_a_position_of_its_own_if_it_is_no_whole_number_of_steps_away():
    assert line(0, 0, 0.25, 0)[:, 0] == pytest.approx([0.0, 0.1, 0.2, 0.25])
    assert line(0, 0, 0.205, 0)[:, 0] == pytest.approx([0.0, 0.1, 0.2])  # as good as there
    assert line(0, 0, 0.3, 0)[:, 0] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert sample_path(np.array([(0.0, 0.0), (0.25, 0.0)]), 0.25)[-1, 0] == 0.25
    assert sample_path(np.array([(0.0, 0.0), (0.25, 0.0)]), 0.24)[-1, 0] == pytest.approx(0.2)


def test_guard_looks_as_far_ahead_as_its_time_and_no_farther():
    """At 0.4 m/s the robot is at 1 m after exactly the 2.5 s of the guard."""

    def released(mate_x_m):
        stands = track(np.array([(mate_x_m, 0.0)]), first=False)
        return release(OWN, 0.4, [stands], MARGINS)

    assert MARGINS.guard_s * 0.4 == 1.0
    assert (released(1.4).positions, released(1.4).by) == (9, 0)
    assert released(1.5).is_whole


def test_ways_meet_where_any_positions_are_nearer_than_reach_and_not_as_near():
    far, near = np.array([(0.0, 0.0), (10.0, 0.0)]), np.array([(5.0, 5.0), (10.0, 0.5)])
    assert meet(far, track(near), 0.11)
    assert not meet(far, track(near), 0.09)
    assert meet(near, track(far), 0.11)
    as_near = Track(np.array([(0.0, 0.5)]), SPEED_M_S, 0, 0.25, goes_first=True)
    assert meet(far, as_near, 0.25) is False
