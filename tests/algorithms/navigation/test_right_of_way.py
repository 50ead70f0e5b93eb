"""The compiled right of way against its docstring, written in plain Python."""

import heapq
import math
from itertools import groupby, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.navigation import right_of_way as escape
from robrain.algorithms.navigation.right_of_way import (
    HEAD_START_S,
    START_CELLS,
    STEP_M,
    DrivenPath,
    Margins,
    PathOrder,
    Release,
    Track,
    escape_cells,
    meet,
    orders,
    release,
    sample_path,
)
from robrain.protocol.model.claim import Claim
from robrain.protocol.model.grid_geometry import GridGeometry

MARGINS = Margins()
SPEED_M_S = 0.6
KEEP_M = 0.4


def line(x0, y0, x1, y1):
    return sample_path(np.array([(x0, y0), (x1, y1)], float), 100.0)


def track(positions, *, first=True, held_at=None):
    held = positions.shape[0] - 1 if held_at is None else held_at
    return Track(positions, SPEED_M_S, held, KEEP_M, goes_first=first)


OWN = line(0, 0, 8, 0)


def test_head_on_who_yields_must_leave_and_who_goes_first_drives_on():
    oncoming = line(8, 0, 0, 0)
    yields = release(OWN, SPEED_M_S, [track(oncoming)], MARGINS)
    assert (yields.positions, yields.must_leave, yields.by) == (1, True, 0)
    assert release(OWN, SPEED_M_S, [track(oncoming, first=False)], MARGINS).is_whole  # it is far away yet


def test_nobody_drives_on_into_one_that_stands_whoever_goes_first():
    stands = track(np.array([(1.0, 0.0)]), first=False)
    allowed = release(OWN, SPEED_M_S, [stands], MARGINS)
    assert 1.0 - OWN[allowed.positions - 1][0] >= KEEP_M + MARGINS.guard_m


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


def test_ways_meet_where_any_positions_are_nearer_than_reach_and_not_as_near():
    far, near = np.array([(0.0, 0.0), (10.0, 0.0)]), np.array([(5.0, 5.0), (10.0, 0.5)])
    assert meet(far, track(near), 0.11)
    assert not meet(far, track(near), 0.09)
    assert meet(near, track(far), 0.11)
    as_near = Track(np.array([(0.0, 0.5)]), SPEED_M_S, 0, 0.25, goes_first=True)
    assert meet(far, as_near, 0.25) is False


claims = st.builds(Claim, cornered=st.integers(0, 2), order_s=st.sampled_from([-20.0, 0.0, 1.5, 9.0]))
names = st.sampled_from(["r1", "r2", "r10"])


@given(claims, claims)
def test_claims_of_two_robots_are_never_equal(one, other):
    assert one.rank("r1") != other.rank("r2")


def test_cornered_robot_goes_before_one_that_set_out_first_and_that_before_the_name():
    assert Claim(cornered=2, order_s=9.0).rank("b") < Claim(cornered=1, order_s=1.0).rank("a")
    assert Claim(order_s=1.0).rank("b") < Claim(order_s=9.0).rank("a")
    assert Claim(order_s=1.0).rank("a") < Claim(order_s=1.0).rank("b") < Claim().rank("a")


@given(claims, claims)
def test_robots_with_a_lent_claim_come_after_its_owner_and_before_all_others(claim, other):
    lent = claim.lend("a")
    follower = claim.lend("a", to_follower=True)
    assert claim.rank("a") < lent.rank("b") < lent.lend("b").rank("c") < follower.rank("a")
    if claim.rank("a") < other.rank("c") and other.rank("c")[:2] != claim.rank("a")[:2]:
        assert follower.rank("b") < other.rank("c")


def test_order_of_robots_follows_from_who_is_on_whose_remaining_path():
    own = line(0, 0, 4, 0)
    same_way, joins, behind = line(2, 0, 6, 0), line(2, 0, 2, 6), line(-2, 0, 6, 0)
    oncoming, elsewhere = line(3, 0, -3, 0), line(0, 5, 4, 5)
    tracks = [track(each) for each in (same_way, joins, behind, oncoming, elsewhere)]
    found = [PathOrder(each).name for each in orders(own, tracks, 0.1)]
    assert found == ["LEADS", "OTHER", "OWN", "NEITHER", "NEITHER"]


DODGE_M = 0.02
EITHER_WAY_S = 0.5


def _line(draw: np.random.Generator) -> np.ndarray:
    return sample_path(draw.uniform(0.0, 5.0, (int(draw.integers(1, 4)), 2)), 100.0)


def _track(draw: np.random.Generator) -> Track:
    positions = _line(draw)
    last = len(positions) - 1
    held_at = last if draw.random() < 0.6 else int(draw.integers(0, last + 1))
    return Track(positions, draw.choice([0.2, 0.6, 1.1]), held_at, 0.4, goes_first=bool(draw.random() < 0.6))


def _plain_release(own: np.ndarray, speed_m_s: float, tracks: list[Track], margins: Margins) -> Release:
    step_s = STEP_M / speed_m_s
    contested_by, late, meets = [-1] * len(own), [False] * len(own), [False] * len(own)
    for other, track in enumerate(tracks):
        if not track.goes_first:
            continue
        last = len(track.positions) - 1
        for k, place in enumerate(own):
            for j, point in enumerate(track.positions):
                if math.dist(place, point) >= track.keep_m + margins.contest_m:
                    continue
                contested_by[k] = other if contested_by[k] < 0 else contested_by[k]
                own_s, other_s = k * step_s, j * STEP_M / track.speed_m_s
                stays = track.held_at < last or j == last
                waits_there = k == len(own) - 1 and other_s >= own_s
                for crossed, slack_s in ((late, margins.slack_s), (meets, 0.5 * step_s)):
                    crossed[k] |= waits_there or (other_s <= own_s + slack_s and (stays or other_s >= own_s - slack_s))
    end, by, must_leave = len(own), -1, False
    for is_contested, group in groupby(range(len(own)), key=lambda k: contested_by[k] >= 0):
        stretch = list(group)
        begins_here = stretch[0] == 0
        if is_contested and any((meets if begins_here else late)[k] for k in stretch):
            end, by, must_leave = max(stretch[0], 1), contested_by[stretch[0]], begins_here
            break
    for other, track in enumerate(tracks):
        now_m = math.dist(track.positions[0], own[0])
        for k in range(1, end):
            own_s = k * step_s
            if own_s > margins.guard_s:
                break
            step_of_other_s = STEP_M / track.speed_m_s
            low = min(track.held_at, int(max(0.0, own_s - EITHER_WAY_S) / step_of_other_s))
            high = min(track.held_at, int((own_s + EITHER_WAY_S) / step_of_other_s) + 1)
            nearest_m = min(math.dist(track.positions[j], own[k]) for j in range(low, high + 1))
            if nearest_m < track.keep_m + margins.guard_m and nearest_m < now_m - DODGE_M:
                end, by = max(1, k - 1), other
                break
    return Release(end, is_whole=end == len(own), must_leave=must_leave, by=by)


@pytest.mark.slow
def test_release_is_what_its_rules_say_for_any_ways() -> None:
    draw = np.random.default_rng(12)
    seen = []
    for _ in range(400):
        own, tracks = _line(draw), [_track(draw) for _ in range(int(draw.integers(0, 4)))]
        speed_m_s = draw.choice([0.3, 0.6])
        found = release(own, speed_m_s, tracks, MARGINS)
        assert found == _plain_release(own, speed_m_s, tracks, MARGINS)
        seen.append(found)
    assert {found.by for found in seen} == {-1, 0, 1, 2}
    assert {found.must_leave for found in seen} == {False, True}
    assert 50 < sum(found.is_whole for found in seen) < 350


def test_mate_that_hardly_moves_is_foreseen_where_it_is() -> None:
    own = sample_path(np.array([(0.0, 0.0), (4.0, 0.0)]), 100.0)
    other = sample_path(np.array([(1.2, 0.0), (1.2, 4.0)]), 100.0)
    found = release(own, 0.6, [Track(other, 0.0, 0, 0.4, goes_first=False)], MARGINS)
    assert found.positions * STEP_M == pytest.approx(1.2 - 0.4 - MARGINS.guard_m, abs=0.21)


GEOMETRY = GridGeometry(0.2, -1.0, 0.5, 24, 18)
APART_M = 0.2
REACH_M = KEEP_M + APART_M


def _distance_m(cell: tuple[int, int], position: np.ndarray) -> float:
    place = GEOMETRY.center_of(*cell)
    return math.dist((place.x_m, place.y_m), position)


def _drawn_track(draw: np.random.Generator) -> Track:
    positions = sample_path(draw.uniform((-1.0, 0.5), (3.8, 4.1), (int(draw.integers(1, 4)), 2)), 100.0)
    return Track(positions, draw.choice([0.3, 0.9]), len(positions) - 1, KEEP_M, goes_first=bool(draw.random() < 0.7))


def _closes_s(cell: tuple[int, int], start: tuple[int, int], tracks: list[Track]) -> float:
    closes_s = [math.inf]
    for track in tracks:
        for k, position in enumerate(track.positions):
            if track.goes_first and _distance_m(cell, position) < REACH_M:
                closes_s.append(HEAD_START_S + k * STEP_M / track.speed_m_s)
        now = track.positions[0]
        near_m = min(REACH_M, _distance_m(start, now)) if math.dist(cell, start) <= START_CELLS else REACH_M
        if _distance_m(cell, now) < near_m - 1e-9:
            closes_s.append(0.0)
    return min(closes_s)


def _neighbours(free: set[tuple[int, int]], cell: tuple[int, int]) -> list[tuple[int, int]]:
    row, column = cell
    around = [(row + i, column + j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
    return [near for near in around if {near, (row, near[1]), (near[0], column)} <= free]


def _first_refuge_s(free: set[tuple[int, int]], start: tuple[int, int], tracks: list[Track]) -> float:
    """When the first cell is reached that never closes; inf for never."""
    arrives_s, heap = {start: 0.0}, [(0.0, start)]
    while heap:
        at_s, cell = heapq.heappop(heap)
        if math.isinf(_closes_s(cell, start, tracks)):
            return at_s
        for near in _neighbours(free, cell):
            near_s = at_s + math.dist(cell, near) * GEOMETRY.resolution_m / SPEED_M_S
            if near_s < arrives_s.get(near, math.inf) and near_s < _closes_s(near, start, tracks):
                arrives_s[near] = near_s
                heapq.heappush(heap, (near_s, near))
    return math.inf


@pytest.mark.parametrize("window_m", [12.0, 0.8])
def test_way_out_is_the_quickest_on_which_each_cell_is_reached_before_it_closes(
    window_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(escape, "WINDOW_M", window_m)
    within = round(window_m / GEOMETRY.resolution_m)
    draw = np.random.default_rng(3)
    lengths = []
    for _ in range(100):
        mask = draw.random(GEOMETRY.shape) < draw.choice([0.5, 0.75, 0.95])
        tracks = [_drawn_track(draw) for _ in range(int(draw.integers(1, 3)))]
        start = GEOMETRY.cell_of(*draw.choice(tracks[0].positions))
        mask[start] = True
        if min(_distance_m(start, track.positions[0]) for track in tracks) < REACH_M and not any(
            track.goes_first and _distance_m(start, track.positions[0]) < REACH_M - 0.01 for track in tracks
        ):
            continue  # the start lies exactly on the rim of what must not be approached
        free = {
            (int(row), int(column))
            for row, column in np.argwhere(mask)
            if abs(row - start[0]) <= within and abs(column - start[1]) <= within
        }
        cells = escape_cells(mask, GEOMETRY, start, SPEED_M_S, tracks, APART_M)
        expected_s = _first_refuge_s(free, start, tracks)
        if cells is None:
            assert math.isinf(expected_s)
            lengths.append(0)
            continue
        way = [(int(row), int(column)) for row, column in cells]
        assert way[0] == start
        at_s = 0.0
        for before, cell in pairwise(way):
            assert cell in _neighbours(free, before)
            at_s += math.dist(before, cell) * GEOMETRY.resolution_m / SPEED_M_S
            assert at_s < _closes_s(cell, start, tracks)
        assert math.isinf(_closes_s(way[-1], start, tracks))
        assert at_s == pytest.approx(expected_s)
        lengths.append(len(way))
    assert lengths.count(0) >= 3
    assert sum(length > 2 for length in lengths) >= 10
