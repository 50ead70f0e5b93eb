"""What a recorder says of itself, and when: by a virtual clock, with a watch over the disk that the test drives."""

import logging
from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.messages.team.recorder_messages import RecorderState
from robrain.recording.writer import recorder as recorder_telling
from robrain.recording.writer.recorder import SLOW, RecorderReports


class FakeWatch:
    """Stands for the thread that watches the disk."""

    def __init__(self, tell: Callable[[float], None], period_s: float) -> None:
        self.tell = tell
        self.period_s = period_s
        self.steps: list[str] = []

    def begin(self) -> None:
        self.steps.append("begin")

    def end(self) -> None:
        self.steps.append("end")

    def close(self) -> None:
        self.steps.append("close")


class Recorder:
    """A recorder's telling, and what it has said."""

    def __init__(self, *, live: bool) -> None:
        self.said: list[str] = []
        self.why = ""
        self.clock = VirtualClock(0)
        self.telling = RecorderReports(self, self.clock, self.look, live=live)  # type: ignore[arg-type]

    def look(self) -> RecorderState:
        return RecorderState(recorder="rec", why=self.why)

    def put(self, state: RecorderState) -> None:
        assert msgspec.structs.replace(state, why="") == RecorderState(recorder="rec")
        self.said.append(state.why)

    def step(self, at_s: float, *, took_s: float = 0.0, lost: int = 0) -> list[str]:
        """What is said of a step that ends at a time."""
        self.said = []
        self.clock.advance_to(to_ns(at_s - took_s))
        self.telling.begin()
        self.clock.advance_to(to_ns(at_s))
        self.telling.end(lost)
        return self.said


@pytest.fixture
def live(monkeypatch: pytest.MonkeyPatch) -> Recorder:
    monkeypatch.setattr(recorder_telling, "SlowStepTimer", FakeWatch)
    return Recorder(live=True)


@pytest.fixture
def lockstep() -> Recorder:
    return Recorder(live=False)


def watch_of(recorder: Recorder) -> Any:
    return recorder.telling._watch


def test_a_live_recorder_tells_at_once_and_then_each_second(live: Recorder) -> None:
    told = [bool(live.step(at_s)) for at_s in (0.1, 0.1, 0.2, 1.09, 1.1, 1.2, 2.1)]
    assert told == [True, False, False, False, True, False, True]
    assert live.said == [""]


def test_a_clock_that_was_set_back_does_not_silence_it(live: Recorder) -> None:
    live.step(100.0)
    live.clock = live.telling._clock = VirtualClock(to_ns(5.0))
    assert live.step(5.1) == [""]
    assert live.step(5.2) == []


def test_a_recorder_in_lockstep_tells_when_more_is_lost_than_it_told(lockstep: Recorder) -> None:
    told = [bool(lockstep.step(at_s, lost=lost)) for at_s, lost in ((0.1, 0), (1.2, 0), (1.3, 1), (2.5, 1), (2.6, 2))]
    assert told == [False, False, True, False, True]


def test_losses_are_told_once_a_second_at_most(lockstep: Recorder) -> None:
    told = [bool(lockstep.step(at_s, lost=lost)) for at_s, lost in ((1.0, 1), (1.5, 2), (2.0, 3))]
    assert told == [True, False, True]


def test_a_step_that_takes_more_than_a_second_is_told_whatever_else(
    lockstep: Recorder, caplog: pytest.LogCaptureFixture
) -> None:
    assert lockstep.step(5.0, took_s=1.0) == []
    assert caplog.records == []
    assert lockstep.step(6.5, took_s=1.5) == [f"writing took 1.5 s, {SLOW}"]
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    lockstep.why = "messages were lost"
    assert lockstep.step(8.0, took_s=1.25) == [f"messages were lost; writing took 1.2 s, {SLOW}"]


def test_a_disk_that_hangs_is_told_again_and_again_and_logged_once(
    live: Recorder, caplog: pytest.LogCaptureFixture
) -> None:
    watch = watch_of(live)
    assert watch.period_s == 1.0
    for lasted_s in (1.5, 2.0, 3.0):
        watch.tell(lasted_s)
    assert live.said == [f"nothing has been written for {lasted_s} s, {SLOW}" for lasted_s in (1.5, 2.0, 3.0)]
    assert [record.getMessage() for record in caplog.records] == [f"recording has written nothing for 1.5 s, {SLOW}"]


def test_the_watch_follows_each_step_and_ends_with_the_recorder(live: Recorder) -> None:
    live.step(1.0)
    live.telling.close()
    assert watch_of(live).steps == ["begin", "end", "close"]


def test_the_last_that_is_said_is_how_it_ended(lockstep: Recorder) -> None:
    lockstep.why = "the disk is full"
    lockstep.telling.close()
    assert lockstep.said == ["the disk is full"]
