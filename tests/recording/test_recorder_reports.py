"""When a recorder publishes its state, by a virtual clock; a hanging disk is in `test_slow_disk.py`."""

import logging
from collections.abc import Iterator

import pytest

from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.messages.team.recorder_messages import RecorderState
from robrain.recording.writer.recorder import SLOW, RecorderReports


class Reports:
    """Reports of a recorder, and the problems that it has published in its last step."""

    def __init__(self, *, live: bool) -> None:
        self.published: list[str] = []
        self.problem = ""
        self.clock = VirtualClock(0)
        self.reports = RecorderReports(self, self.clock, self.state, live=live)  # type: ignore[arg-type]

    def state(self) -> RecorderState:
        return RecorderState(recorder="rec", why=self.problem)

    def put(self, state: RecorderState) -> None:
        self.published.append(state.why)

    def step(self, at_s: float, *, took_s: float = 0.0, lost: int = 0) -> list[str]:
        """What is published after a step that ends at a time."""
        self.published = []
        self.clock.advance_to(to_ns(at_s - took_s))
        self.reports.begin()
        self.clock.advance_to(to_ns(at_s))
        self.reports.end(lost)
        return self.published


@pytest.fixture
def live() -> Iterator[Reports]:
    live = Reports(live=True)
    yield live
    live.reports.close()


@pytest.fixture
def lockstep() -> Reports:
    return Reports(live=False)


def test_live_recorder_reports_at_once_and_then_each_second(live: Reports) -> None:
    reported = [bool(live.step(at_s)) for at_s in (0.1, 0.1, 0.2, 1.09, 1.1, 1.2, 2.1)]
    assert reported == [True, False, False, False, True, False, True]


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ([(0.1, 0), (1.2, 0), (1.3, 1), (2.5, 1), (2.6, 2)], [False, False, True, False, True]),
        ([(1.0, 1), (1.5, 2), (2.0, 3)], [True, False, True]),
    ],
)
def test_recorder_in_lockstep_reports_new_losses_once_a_second(
    lockstep: Reports, steps: list[tuple[float, int]], expected: list[bool]
) -> None:
    assert [bool(lockstep.step(at_s, lost=lost)) for at_s, lost in steps] == expected


def test_step_of_more_than_a_second_is_always_reported(lockstep: Reports, caplog: pytest.LogCaptureFixture) -> None:
    assert lockstep.step(5.0, took_s=1.0) == []
    assert lockstep.step(6.5, took_s=1.5) == [f"writing took 1.5 s, {SLOW}"]
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    lockstep.problem = "messages were lost"
    assert lockstep.step(8.0, took_s=1.25) == [f"messages were lost; writing took 1.2 s, {SLOW}"]
