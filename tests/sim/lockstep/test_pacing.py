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


def test_the_first_interrupt_asks_and_the_second_is_let_through():
    before = signal.getsignal(signal.SIGINT)
    with StopOnInterrupt() as interrupt:
        assert not interrupt.requested
        os.kill(os.getpid(), signal.SIGINT)
        assert interrupt.requested
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_being_asked_to_terminate_is_an_interrupt_too():
    before = signal.getsignal(signal.SIGTERM)
    with StopOnInterrupt() as interrupt:
        os.kill(os.getpid(), signal.SIGTERM)
        assert interrupt.requested
    assert signal.getsignal(signal.SIGTERM) is before


def test_handlers_are_put_back_when_the_run_fails():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ValueError, match="the run failed"), StopOnInterrupt():
        raise ValueError("the run failed")
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
