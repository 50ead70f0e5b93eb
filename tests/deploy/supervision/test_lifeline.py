"""The pipe between a process and its supervisor."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

from robrain.deploy.processes.live_process import BEAT_S, LIFELINE_VARIABLE, Lifeline, LifelineEnd, LiveStop


class Clock:
    """Seconds that the test moves."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def end(monkeypatch) -> Iterator[LifelineEnd]:
    """A supervisor's end, whose other end the next Lifeline takes."""
    end = LifelineEnd()
    monkeypatch.setenv(LIFELINE_VARIABLE, str(os.dup(end.pass_on)))
    yield end
    end.close()


@pytest.fixture
def _own_signals() -> Iterator[None]:
    kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in kept.items():
        signal.signal(number, handler)


def test_beats_and_readiness_arrive(end) -> None:
    clock = Clock()
    lifeline = Lifeline(clock)
    lifeline.beat()
    assert end.pulse() == (1, False)
    clock.now_s += BEAT_S
    lifeline.beat()
    lifeline.ready()
    assert end.pulse() == (1, True)
    assert end.pulse() == (0, False)


def test_loop_that_is_faster_beats_no_more_often(end) -> None:
    clock = Clock()
    lifeline = Lifeline(clock)
    for _ in range(1000):
        lifeline.beat()
        clock.now_s += 0.001
    assert 1.0 / BEAT_S <= end.pulse().beats <= 1.0 / BEAT_S + 1


@pytest.mark.slow
def test_supervisor_that_reads_nothing_holds_up_no_process(end) -> None:
    clock = Clock()
    lifeline = Lifeline(clock)
    for _ in range(200_000):  # more than a pipe holds
        clock.now_s += BEAT_S
        lifeline.beat()
    assert not lifeline.is_cut
    assert end.pulse().beats > 0


def test_process_notices_that_its_supervisor_has_gone(end) -> None:
    lifeline = Lifeline(Clock())
    end.close()
    lifeline.beat()
    assert lifeline.is_cut


@pytest.mark.usefixtures("_own_signals")
def test_main_loop_that_asks_whether_to_stop_beats(end) -> None:
    should_stop = LiveStop()
    assert not should_stop()
    should_stop.ready()
    assert end.pulse() == (1, True)


@pytest.mark.usefixtures("end")
def test_processes_that_it_starts_do_not_beat_for_it() -> None:
    number = os.environ[LIFELINE_VARIABLE]
    os.set_inheritable(int(number), True)  # as it is in the process that it was passed to
    Lifeline(Clock())
    assert LIFELINE_VARIABLE not in os.environ
    script = f"import os\ntry:\n os.write({number}, b'.')\nexcept OSError:\n print('closed')"
    said = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, close_fds=False
    ).stdout
    assert said == "closed\n"


@pytest.mark.parametrize("text", ["", "x", "-1", "987654"])
def test_process_without_a_supervisor_does_not_mind(monkeypatch, text: str) -> None:
    monkeypatch.setenv(LIFELINE_VARIABLE, text)
    lifeline = Lifeline(Clock())
    lifeline.beat()
    lifeline.ready()
    assert not lifeline.is_cut
