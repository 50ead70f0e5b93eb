import pytest

from robrain.plugins.device.mocdevice.frame_clock import WINDOW
from robrain.plugins.device.ros2.topic_device import StampClock
from robrain.protocol.clock import NS_PER_S, to_ns

NOW_NS = 1_700_000_000 * NS_PER_S


def test_a_stamp_of_the_robots_clock_is_the_time_of_measurement_however_late_it_comes():
    clock = StampClock()
    for delay_s in (0.05, 0.30, 0.05):
        assert clock.measured_ns(NOW_NS, NOW_NS + to_ns(delay_s)) == NOW_NS


def test_a_message_without_a_stamp_was_measured_when_it_came():
    assert StampClock().measured_ns(0, NOW_NS) == NOW_NS


@pytest.mark.parametrize("ahead_s", [40.0, -40.0, 0.02, -1_700_000_000.0 + 12.0])
def test_a_stamp_of_another_clock_is_converted_with_the_least_delay_of_late(ahead_s):
    clock = StampClock()
    for step in range(50):
        stamp_ns = NOW_NS + to_ns(0.1 * step)
        delay_ns = to_ns(0.002 if step % 5 == 0 else 0.06)
        measured_ns = clock.measured_ns(stamp_ns + to_ns(ahead_s), stamp_ns + delay_ns)
        assert measured_ns == stamp_ns + to_ns(0.002)


def test_no_time_of_measurement_is_after_the_arrival():
    assert StampClock().measured_ns(NOW_NS + to_ns(0.004), NOW_NS) == NOW_NS


def test_a_clock_that_is_set_back_is_followed():
    clock = StampClock()
    for step in range(20):
        clock.measured_ns(NOW_NS + step, NOW_NS + step)
    later_ns = NOW_NS + 10 * NS_PER_S
    assert clock.measured_ns(NOW_NS - 100 * NS_PER_S, later_ns) == later_ns


def test_another_clock_that_runs_slower_is_followed_within_two_windows():
    clock = StampClock()
    measured_ns = arrived_ns = 0
    for step in range(3 * WINDOW):
        passed_ns = step * to_ns(0.1)
        arrived_ns = NOW_NS + passed_ns
        measured_ns = clock.measured_ns(to_ns(1.0) + passed_ns - passed_ns // 10_000, arrived_ns)
    assert arrived_ns - measured_ns <= to_ns(2 * WINDOW * 0.1 / 10_000)
