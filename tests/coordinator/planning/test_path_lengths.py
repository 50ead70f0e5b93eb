"""How far it is along the floor, and what that takes whom."""

import zlib

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.coordinator.planning.energy_budget import DETOUR, kinds_of, mean_within, profile_of
from robrain.coordinator.planning.path_lengths import PathLengths
from robrain.coordinator.planning.problem_codec import (
    NO_PATH,
    ProblemRecord,
    Profile,
    decode,
    encode_lengths,
    from_deltas,
    to_deltas,
)
from robrain.coordinator.planning.snapshot import Floor
from robrain.protocol.model.energy_model import Work, estimate
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from robrain.protocol.model.zone import Zone, ZoneKind
from tests.coordinator.planning.worlds import model

GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 100, 60)


def floor(*, unknown_from_m: float = 99.0) -> Floor:
    """A room of 10 × 6 m with a wall at x = 5 that is open above y = 5."""
    classes = np.full(GEOMETRY.shape, FREE, np.int8)
    classes[:50, 50] = OCCUPIED
    classes[:, round(10 * unknown_from_m) :] = UNKNOWN
    return Floor(classes, GEOMETRY, 1)


WEST, EAST, NEAR = Point2D(4.0, 1.0), Point2D(6.0, 1.0), Point2D(4.0, 3.0)


def test_a_way_goes_around_the_wall():
    length_m = PathLengths(floor(), 0.3, 1.5).lengths_m([WEST, EAST], [NEAR])
    assert length_m[0, 1] == pytest.approx(9.0, abs=1.0)
    assert length_m[0, 2] == pytest.approx(2.0, abs=0.1)
    assert length_m[1, 2] == pytest.approx(7.0, abs=1.0)
    assert (length_m == length_m.T).all()
    assert (np.diag(length_m) == 0).all()


def test_unknown_floor_may_be_gone_over_and_counts_for_more():
    known = PathLengths(floor(), 0.3, 1.5).lengths_m([WEST, Point2D(1.0, 1.0)], [])[0, 1]
    classes = np.full(GEOMETRY.shape, UNKNOWN, np.int8)
    unknown = PathLengths(Floor(classes, GEOMETRY, 1), 0.3, 1.5).lengths_m([WEST, Point2D(1.0, 1.0)], [])[0, 1]
    assert unknown == pytest.approx(1.5 * known, rel=0.05)


def test_there_is_no_way_into_a_wall_or_through_a_gap_that_is_too_narrow():
    ways = PathLengths(floor(), 0.3, 1.5)
    assert np.isinf(ways.lengths_m([Point2D(-5.0, 1.0), WEST], [])[0, 1])
    assert np.isinf(PathLengths(floor(), 1.2, 1.5).lengths_m([WEST, EAST], [])[0, 1])


def narrow_door(rows: int) -> Floor:
    """A room of 10 × 6 m with a wall at x = 5, which has a door of the given number of cells at y = 2."""
    classes = np.full(GEOMETRY.shape, FREE, np.int8)
    classes[:, 50] = OCCUPIED
    classes[20 : 20 + rows, 50] = FREE
    return Floor(classes, GEOMETRY, 1)


def test_a_narrow_path_counts_where_there_is_no_other():
    door = narrow_door(3)
    assert np.isinf(PathLengths(door, 0.28, 1.5).lengths_m([WEST, EAST], [NEAR])[0, 1])
    length_m = PathLengths(door, 0.28, 1.5, 0.12).lengths_m([WEST, EAST], [NEAR])
    assert 3.0 < length_m[0, 1] < 6.0
    assert length_m[0, 2] == PathLengths(door, 0.28, 1.5).lengths_m([WEST, EAST], [NEAR])[0, 2]
    assert (length_m == length_m.T).all()
    assert np.isinf(PathLengths(narrow_door(1), 0.28, 1.5, 0.12).lengths_m([WEST, EAST], [])[0, 1])


def test_a_narrow_way_is_not_taken_for_a_short_cut():
    wide = floor()
    wide.classes[20:23, 50] = FREE
    assert PathLengths(wide, 0.28, 1.5, 0.12).lengths_m([WEST, EAST], [])[0, 1] > 7.0


def test_without_a_map_ways_are_straight_and_half_as_long_again():
    assert PathLengths(None, 0.3, 1.5).lengths_m([WEST, EAST], [])[0, 1] == DETOUR * 2.0


def test_what_a_way_takes_is_what_the_robots_own_model_says():
    one = model(50_000.0)
    profile = profile_of(one, 1.0)
    for length_m in (1.0, 7.0, 100.0):
        told = estimate(one, Work(path_m=length_m))
        assert profile.start_j + profile.j_per_m * length_m == pytest.approx(told.mean_j)
        assert profile.s_per_m * length_m == pytest.approx(told.duration_s)


@pytest.mark.parametrize(("waits_s", "drift_w2_per_s"), [(0.0, 1e-5), (100.0, 1e-5), (5000.0, 1e-5), (5000.0, 1e-3)])
def test_work_within_the_mean_is_within_the_bound(waits_s, drift_w2_per_s):
    one = msgspec.structs.replace(model(50_000.0), drift_w2_per_s=drift_w2_per_s)
    mean_j = mean_within(one, 40_000.0, waits_s, 0.95)
    assert 20_000.0 < mean_j < 40_000.0
    profile = profile_of(one, 1.0)
    for share in np.linspace(0.0, 1.0, 11):
        wait_s = share * min(waits_s, mean_j / 8.0)
        path_m = max(0.0, mean_j - 8.0 * wait_s) / profile.j_per_m
        assert estimate(one, Work(path_m=path_m, wait_s=wait_s)).high_j(0.95) <= 40_000.0 * 1.005
    assert mean_within(one, -5.0, 10.0, 0.95) == -5.0


def test_equal_robots_are_one_kind_and_no_robots_ways_take_more_than_its_kinds():
    rng = np.random.default_rng(1)
    profiles = [Profile(float(a), float(b), float(c)) for a, b, c in rng.uniform(1.0, 60.0, (200, 3))]
    merged, index = kinds_of(profiles)
    assert len(merged) <= 16
    for one, kind in zip(profiles, index, strict=True):
        assert merged[kind].j_per_m >= one.j_per_m
        assert merged[kind].s_per_m >= one.s_per_m
    assert len(kinds_of([Profile(1.0, 30.0, 2.0), Profile(1.0, 30.1, 2.0)])[0]) == 1
    assert len(kinds_of([Profile(1.0, 30.0, 2.0), Profile(1.0, 40.0, 2.0)])[0]) == 2


def test_a_question_is_the_same_after_it_was_written_down():
    length_m = np.array([[0.0, 1.234, np.inf], [1.234, 0.0, 5.0], [np.inf, 5.0, 0.0]])
    asked = ProblemRecord(
        jobs=(), workers=(), profiles=(Profile(2.0, 10.0, 0.5),), places=3, paths_cm=encode_lengths(length_m)
    )  # fmt: skip
    again = decode(asked.encode())
    assert again == asked
    problem = again.problem()
    assert problem.energy_j[0, 0, 1] == pytest.approx(2.0 + 10.0 * 1.24)
    assert np.isinf(problem.time_s[0, 0, 2])
    with pytest.raises(ValueError, match="expected a question"):
        decode(b"nonsense")


def test_what_was_written_down_before_lengths_were_written_as_differences_is_still_read():
    length_m = np.array([[0.0, 1.234, np.inf], [1.234, 0.0, 2.0], [np.inf, 2.0, 0.0]])
    asked = ProblemRecord(
        jobs=(), workers=(), profiles=(Profile(2.0, 10.0, 0.5),), places=3, paths_cm=encode_lengths(length_m)
    )
    old = {{"paths_cm": "ways_cm"}.get(name, name): value for name, value in msgspec.structs.asdict(asked).items()}
    assert decode(zlib.compress(msgspec.msgpack.encode(old), 1)) == asked


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 12), st.randoms(use_true_random=False))
def test_lengths_come_back_as_they_were(places, chance):
    count = places * (places - 1) // 2
    lengths = [chance.choice([NO_PATH, 0, chance.randrange(5000), chance.randrange(2**30)]) for _ in range(count)]
    cm = np.array(lengths, np.uint32)
    packed = to_deltas(cm, places)
    assert from_deltas(packed, places).tolist() == lengths
    if places > 1:
        with pytest.raises(ValueError, match="expected"):
            from_deltas(packed[:-1], places)
        with pytest.raises(ValueError, match="order"):
            from_deltas(packed[4:8] + packed[4:], places)


HALL = np.full(GEOMETRY.shape, FREE, np.int8)
LEFT, RIGHT = Point2D(1.05, 3.05), Point2D(9.05, 3.05)


def lengths_across(robot, *zones, pace_m_s=0.5):
    """Path length from the left to the right of an open hall of 10 × 6 m."""
    paths = PathLengths(Floor(HALL, GEOMETRY, 1, zones), 0.3, 1.5)
    return paths.of(robot, pace_m_s).lengths_m([LEFT, RIGHT], [])[0, 1]


def strip(kind, y1=6.0, **fields):
    corners_m = ((4.0, 0.0), (6.0, 0.0), (6.0, y1), (4.0, y1))
    return Zone(name=kind, kind=kind, corners_m=corners_m, **fields)


def test_a_metre_with_a_speed_limit_counts_as_the_metres_of_the_same_time():
    """A robot slows down before the strip of 2 m, so it drives 3 m at the limit."""
    slow = strip(ZoneKind.SPEED_LIMIT, speed_m_s=0.1)
    for pace_m_s in (0.3, 0.5):
        seconds = lengths_across("r1", slow, pace_m_s=pace_m_s) / pace_m_s
        assert seconds == pytest.approx(5.0 / pace_m_s + 3.0 / 0.1, rel=0.05)
    assert lengths_across("r1", strip(ZoneKind.SPEED_LIMIT, speed_m_s=0.6)) == pytest.approx(8.0, abs=0.1)


def test_a_penalty_leads_round_a_zone_and_does_not_count_inside():
    avoided = strip(ZoneKind.PENALTY, y1=4.5, cost_m=5.0)
    assert 8.7 < lengths_across("r1", avoided) < 10.5
    assert lengths_across("r1", strip(ZoneKind.PENALTY, cost_m=5.0)) == pytest.approx(8.0, abs=0.1)


def test_zones_of_single_robots_change_their_lengths_alone():
    shut = strip(ZoneKind.KEEP_OUT, robots=("r1",))
    assert np.isinf(lengths_across("r1", shut))
    assert lengths_across("r2", shut) == pytest.approx(8.0, abs=0.1)


def test_robots_with_different_lengths_have_tables_of_their_own():
    tables_m = [np.array([[0.0, length_m], [length_m, 0.0]]) for length_m in (1.0, np.inf)]
    profiles = (Profile(2.0, 10.0, 0.5), Profile(2.0, 10.0, 0.5, 1))
    paths_cm = b"".join(map(encode_lengths, tables_m))
    asked = ProblemRecord(jobs=(), workers=(), profiles=profiles, places=2, paths_cm=paths_cm)
    assert decode(asked.encode()) == asked
    assert asked.problem().time_s[:, 0, 1].tolist() == [0.5, np.inf]
    assert asked.problem().energy_j[:, 0, 1].tolist() == [12.0, np.inf]
    assert kinds_of(profiles) == ([*profiles], [0, 1])
