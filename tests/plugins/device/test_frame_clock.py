"""When encoder frames were measured, by stamps of their sending and by stamps of their arrival."""

import pytest

from robrain.plugins.device.mocdevice.frame_clock import RESTART_FRAMES, WINDOW, FrameClock, StampedAt
from robrain.protocol.clock import to_ns

START_NS, FRAME_PERIOD_NS = to_ns(100.0), to_ns(0.02)


def sent_ns(number):
    return START_NS + number * FRAME_PERIOD_NS


def hear(clock, number, late_ns=0):
    """A frame stamped as it arrives; when it was measured, as far as is known now."""
    arrived_ns = sent_ns(number) + late_ns
    return clock.add(number & 0xFF, arrived_ns, arrived_ns) + clock.offset_ns


@pytest.mark.parametrize("stamped_at", list(StampedAt))
def test_frames_that_are_in_time_were_measured_as_their_stamps_say(stamped_at):
    clock = FrameClock(stamped_at, FRAME_PERIOD_NS)
    assert [hear(clock, number) for number in range(300)] == [sent_ns(number) for number in range(300)]


def test_burst_of_frames_stamped_on_arrival_was_measured_over_the_time_that_the_counter_says():
    clock = FrameClock(StampedAt.ARRIVAL, FRAME_PERIOD_NS)
    for number in range(5):
        hear(clock, number)
    burst = [hear(clock, number, sent_ns(60) - sent_ns(number)) for number in range(5, 60)]
    assert burst == [sent_ns(number) for number in range(5, 60)]


def test_controller_whose_clock_is_slow_is_followed_within_two_windows():
    clock = FrameClock(StampedAt.ARRIVAL, FRAME_PERIOD_NS)
    slow_ns = 4000  # 0.2 ms a second
    for number in range(20 * WINDOW):
        lag_ns = number * slow_ns
        behind_ns = sent_ns(number) + lag_ns - hear(clock, number, lag_ns)
        assert 0 <= behind_ns <= 2 * WINDOW * slow_ns


@pytest.mark.parametrize("counter", [1, 200])
def test_after_a_silence_longer_than_the_counter_can_tell_the_stamp_counts(counter):
    clock = FrameClock(StampedAt.ARRIVAL, FRAME_PERIOD_NS)
    hear(clock, 0)
    now_ns = sent_ns(0) + RESTART_FRAMES * FRAME_PERIOD_NS + 2 * FRAME_PERIOD_NS
    assert clock.add(counter, now_ns, now_ns) + clock.offset_ns == now_ns
    now_ns += FRAME_PERIOD_NS
    assert clock.add(counter + 1, now_ns, now_ns) + clock.offset_ns == now_ns


def test_controller_that_has_started_anew_counts_from_its_first_stamp():
    clock = FrameClock(StampedAt.ARRIVAL, FRAME_PERIOD_NS)
    hear(clock, 0)
    clock.restart_stamp()
    now_ns = sent_ns(9)
    assert clock.add(1, now_ns, now_ns) + clock.offset_ns == now_ns


@pytest.mark.parametrize("stamped_at", list(StampedAt))
@pytest.mark.parametrize("stamp_s", [0.0, 98.9, 101.1, 1e9])
def test_stamps_of_another_clock_are_replaced_by_the_robots_time(stamped_at, stamp_s):
    clock = FrameClock(stamped_at, FRAME_PERIOD_NS)
    for number in range(5):
        assert clock.add(number, to_ns(stamp_s), sent_ns(number)) + clock.offset_ns == sent_ns(number)
