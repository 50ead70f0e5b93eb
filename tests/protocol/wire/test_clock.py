import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.wire.clock import NS_PER_S, VirtualClock, WallClock, to_ns, to_seconds


def test_a_virtual_clock_stands_still_until_it_is_moved():
    clock = VirtualClock()
    assert clock.now_ns() == clock.now_ns() == 0
    clock.advance_to(5)
    clock.advance_to(5)
    assert clock.now_ns() == 5


def test_time_does_not_run_backwards():
    clock = VirtualClock(start_ns=7)
    with pytest.raises(ValueError, match="time would run backwards: 6 ns after 7 ns"):
        clock.advance_to(6)
    assert clock.now_ns() == 7


def test_the_wall_clock_counts_nanoseconds_since_1970():
    years = WallClock().now_ns() / NS_PER_S / (365.25 * 24 * 3600)
    assert 55 < years < 200


@given(st.floats(-1e6, 1e6))
def test_seconds_survive_as_whole_nanoseconds(duration_s):
    assert to_seconds(to_ns(duration_s)) == pytest.approx(duration_s, abs=1e-9)


def test_a_fiftieth_of_a_second_is_exact():
    assert to_ns(0.02) == 20_000_000
    assert to_ns(3 * 0.1) == 300_000_000  # 0.30000000000000004 s
