"""Level tracks: what is known of one mote, whatever order its readings come in."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.coordinator.rules.rule_state import RATE_READINGS_MAX, RUNS_MAX, SILENT_NS, Class, LevelTrack, TrackTable
from robrain.protocol.clock import to_ns
from robrain.protocol.model.rules.rule import ReadingCondition

GAP_NS = to_ns(10.0)


def track(**condition):
    return LevelTrack(msgspec.convert({"quantity": "t", **condition}, ReadingCondition))


def noted(readings, **condition):
    """A track that has heard (seconds, value), in this order."""
    found = track(**condition)
    for at_s, value in readings:
        found.record(to_ns(at_s), value, GAP_NS)
    return found


@given(st.permutations([(0, 1.0), (2, 9.0), (4, 9.0), (6, 9.0), (8, 9.0), (9, 9.0)]))
def test_order_of_arrival_does_not_matter_to_what_was_held(readings):
    found = noted(readings, above=5.0)
    assert (found.held_s, found.newest, found.value, found.newest_ns) == (7.0, Class.HOLDS, 9.0, to_ns(9))


@pytest.mark.parametrize(("apart_s", "held_s"), [(10, 10.0), (-10, 10.0), (11, 0.0)])
def test_a_condition_has_held_between_readings_that_are_no_farther_apart_than_the_gap(apart_s, held_s):
    assert noted([(20, 9.0), (20 + apart_s, 9.0)], above=5.0).held_s == held_s


@given(st.permutations([(0, 9.0), (2, 9.0), (4, 1.0), (6, 9.0), (8, 9.0)]), st.randoms(use_true_random=False))
def test_a_break_is_a_break_in_whatever_order_it_is_heard_of(readings, random):
    doubled = [*readings, *random.sample(readings, 3)]
    found = noted(doubled, above=5.0)
    # Less than the readings show may be known, where one within a run came late; more never.
    assert found.held_s in (0.0, 2.0)


@given(st.lists(st.tuples(st.integers(0, 200), st.floats(-10, 10, allow_nan=False)), max_size=300))
def test_memory_stays_bounded_and_times_are_never_longer_than_what_was_heard(readings):
    level, rate = noted(readings, above=5.0), noted(readings, rising_per_min=3.0, over_s=30.0)
    assert len(level._runs) <= RUNS_MAX
    assert len(rate._rates) <= RATE_READINGS_MAX + 1
    if level.held_s is not None:
        held = [at_s for at_s, value in readings if value > 5.0]
        assert level.held_s <= max(held) - min(held)


@pytest.mark.parametrize(
    ("condition", "value", "expected"),
    [
        ({"above": 5.0}, 5.0, Class.CLEAR),
        ({"above": 5.0}, 5.1, Class.HOLDS),
        ({"above": 5.0, "clear_at": 3.0}, 5.0, Class.BETWEEN),
        ({"above": 5.0, "clear_at": 3.0}, 3.0, Class.CLEAR),
        ({"below": 5.0}, 5.0, Class.CLEAR),
        ({"below": 5.0}, 4.9, Class.HOLDS),
        ({"below": 5.0, "clear_at": 7.0}, 6.9, Class.BETWEEN),
        ({"below": 5.0, "clear_at": 7.0}, 7.0, Class.CLEAR),
        ({"below": -5.0, "clear_at": -3.0}, -4.0, Class.BETWEEN),
    ],
)
def test_each_side_of_threshold_and_clear_level(condition, value, expected):
    assert noted([(0, value)], **condition).newest is expected


@pytest.mark.parametrize("per_min", [6.0, -6.0, 0.0])
def test_rate_is_the_slope_of_the_line_per_minute(per_min):
    readings = [(at_s, 20.0 + per_min * at_s / 60.0) for at_s in range(0, 31, 3)]
    assert noted(readings, rising_per_min=1.0, over_s=30.0).rate_per_min == pytest.approx(per_min)


def test_rate_forgets_what_is_older_than_its_time():
    flat_then_steep = [(at_s, 20.0) for at_s in range(60)] + [(60 + at_s, 20.0 + at_s) for at_s in range(31)]
    assert noted(flat_then_steep, rising_per_min=1.0, over_s=30.0).rate_per_min == pytest.approx(60.0, rel=0.05)


@pytest.mark.parametrize("apart_s", [0.4, 2.0])
def test_of_readings_close_together_the_rate_counts_one(apart_s):
    """Readings closer than a part of `over_s`, before or after, would fill the list without a better slope."""
    found = noted([(0, 0.0), (10, 10.0), (20, 20.0), (30, 30.0)], rising_per_min=1.0, over_s=30.0)
    for at_s in (apart_s, 20 + apart_s, 20 - apart_s):
        found.record(to_ns(at_s), 1000.0, GAP_NS)
    assert (found.rate_per_min == pytest.approx(60.0)) is (apart_s < 30.0 / RATE_READINGS_MAX)


def test_a_full_table_replaces_a_mote_that_is_silent_and_no_other():
    condition = msgspec.convert({"quantity": "t", "above": 5.0}, ReadingCondition)
    table = TrackTable(capacity=2)
    first = table.of("rule", "m1", condition, 0)
    assert table.of("rule", "m2", condition, to_ns(30)) is not None
    assert table.of("rule", "m3", condition, SILENT_NS - 1) is None
    assert len(table) == 2
    assert table.of("rule", "m3", condition, SILENT_NS) is not None
    assert len(table) == 2
    assert table.of("rule", "m1", condition, to_ns(100)) is not first
