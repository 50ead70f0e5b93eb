import os
import signal

import pytest

from robrain.protocol.workers import OwnedThread
from robrain.sim.lockstep import pacing
from robrain.sim.lockstep.pacing import Pacer, StopOnInterrupt


class Wall:
    """The wall clock, in the hands of the test."""

    def __init__(self):
        self.now_s = 100.0

    def perf_counter(self):
        return self.now_s

    def sleep(self, duration_s):
        assert duration_s > 0
        self.now_s += duration_s


@pytest.fixture
def wall(monkeypatch):
    wall = Wall()
    monkeypatch.setattr(pacing.time, "perf_counter", wall.perf_counter)
    monkeypatch.setattr(pacing.time, "sleep", wall.sleep)
    return wall


@pytest.mark.parametrize(("speed", "expected_s"), [(1.0, 10.0), (4.0, 2.5), (0.5, 20.0), (0.0, 0.0)])
def test_a_run_takes_its_time_divided_by_the_speed(wall, speed, expected_s):
    pacer = Pacer(speed)
    for tick in range(1, 501):
        pacer.wait(tick * 0.02)
    assert wall.now_s - 100.0 == pytest.approx(expected_s)


def test_a_run_that_fell_behind_goes_on_at_its_pace_and_does_not_rush(wall):
    pacer = Pacer(1.0)
    pacer.wait(1.0)
    wall.now_s += 30.0  # the computer slept
    pacer.wait(2.0)
    before_s = wall.now_s
    pacer.wait(3.0)
    assert wall.now_s - before_s == pytest.approx(1.0)


@pytest.mark.parametrize("first", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_asks_and_the_second_is_let_through(first):
    before = signal.getsignal(signal.SIGINT)
    with StopOnInterrupt() as interrupt:
        assert not interrupt.requested
        os.kill(os.getpid(), first)
        assert interrupt.requested
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_outside_of_the_main_thread_signals_are_left_alone():
    before = signal.getsignal(signal.SIGINT)
    seen = []

    def run():
        with StopOnInterrupt() as interrupt:
            seen.append((signal.getsignal(signal.SIGINT), interrupt.requested))

    thread = OwnedThread("thread", run)
    thread.close()
    assert seen == [(before, False)]
