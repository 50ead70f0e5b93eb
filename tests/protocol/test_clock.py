import time

import pytest

from robrain.protocol.clock import LiveClock, clock_difference_ns, steps, to_ns

DAY_S = 86_400.0


@pytest.mark.parametrize("set_by_s", [20 * DAY_S, 54 * 365 * DAY_S, -7200.0])
def test_a_live_clock_counts_from_1970_and_no_setting_of_the_wall_clock_moves_it(monkeypatch, set_by_s):
    wall_ns, clock = time.time_ns, LiveClock()
    before_ns = clock.now_ns()
    assert abs(before_ns - wall_ns()) < to_ns(60.0)
    monkeypatch.setattr(time, "time_ns", lambda: wall_ns() + to_ns(set_by_s))
    for later in (clock, LiveClock()):  # those that are made later in the process have the same offset
        assert 0 <= later.now_ns() - before_ns < to_ns(5.0)
    assert clock.of_wall_ns(time.time_ns() - to_ns(1.0)) == pytest.approx(clock.now_ns() - to_ns(1.0), abs=to_ns(0.5))


@pytest.mark.parametrize(("ahead_s", "differs"), [(0.0, 0), (5.0, 0), (5.1, 1), (-60.0, 0), (-61.0, 1), (-1e9, 1)])
def test_clocks_differ_if_a_stamp_is_farther_off_than_synchronised_clocks_and_a_network_explain(ahead_s, differs):
    now_ns = to_ns(2e9)
    assert clock_difference_ns(now_ns + to_ns(ahead_s), now_ns) == differs * to_ns(ahead_s)
    assert clock_difference_ns(0, now_ns) == 0  # no stamp


def test_steps_come_one_a_period_and_a_long_one_delays_the_next(monkeypatch):
    now_s, begun_s = [0.0], []
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    monkeypatch.setattr(time, "sleep", lambda pause_s: now_s.append(now_s.pop() + pause_s))
    for _ in steps(lambda: len(begun_s) == 4, 2.0):
        begun_s.append(now_s[0])
        now_s[0] += 5.0 if len(begun_s) == 2 else 0.5
    assert begun_s == [0.0, 2.0, 7.0, 9.0]
