"""Processes that are started again, given up, and leave nothing behind; `robrain hub` is the process."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable

import pytest

from robrain.deploy.errors import ChildFailed
from robrain.deploy.supervision import guard
from robrain.deploy.supervision.part import Cause, CoreWait, Part, PartEvent, PartEventKind, RestartPolicy
from robrain.deploy.supervision.supervisor import Supervisor
from tests.waiting import has_ended, until

QUICK = RestartPolicy(first_delay_s=0.01, limit=2, hang_s=1.0)
HUB = ["hub", "--listen", "tcp/127.0.0.1:0"]
WRONG = ["hub", "--listen", "nowhere"]


@pytest.fixture
def run():
    """Supervises one part."""
    events: list[PartEvent] = []
    supervisor = Supervisor(events.append)

    def run(words: list[str], *, must_start: bool = False) -> tuple[Supervisor, list[PartEvent]]:
        supervisor.__enter__()
        supervisor.add([Part("hub", lambda _: words, QUICK, is_vital=True, must_start=must_start)])
        return supervisor, events

    yield run
    supervisor.__exit__(None, None, None)


def wait(supervisor: Supervisor, condition: Callable[[], object]) -> None:
    until(condition, step=supervisor.update)


def kinds(events: list[PartEvent]) -> list[PartEventKind]:
    return [event.kind for event in events]


@pytest.mark.slow
def test_killed_process_is_started_again_and_what_it_had_started_is_gone(run) -> None:
    supervisor, events = run(HUB)
    hub = supervisor.named("hub")
    wait(supervisor, lambda: hub.is_up)
    first = hub.child.pid
    os.kill(first, signal.SIGKILL)
    wait(supervisor, lambda: PartEventKind.UP_AGAIN in kinds(events))
    assert hub.child.pid != first
    assert has_ended(first)
    assert kinds(events) == ["started", "up", "failed", "started", "up_again"]
    assert events[2].words == "hub was ended by SIGKILL; it is started again in 0.0 s"
    assert events[4].words.startswith("hub is up again after ")
    assert hub.restarts.restarts == 1


@pytest.mark.slow
def test_process_that_stands_still_is_killed_and_started_again(run) -> None:
    supervisor, events = run(HUB)
    hub = supervisor.named("hub")
    wait(supervisor, lambda: hub.is_up)
    os.kill(hub.child.pid, signal.SIGSTOP)
    wait(supervisor, lambda: PartEventKind.UP_AGAIN in kinds(events))
    assert events[2].cause is Cause.SILENT
    assert events[2].words.startswith("hub was silent for 1.")


@pytest.mark.slow
def test_process_that_waits_for_a_core_has_more_time(run, monkeypatch) -> None:
    monkeypatch.setattr(CoreWait, "since_last_s", lambda _: 1.0)
    supervisor, events = run(HUB)
    hub = supervisor.named("hub")
    wait(supervisor, lambda: hub.is_up)
    os.kill(hub.child.pid, signal.SIGSTOP)
    stopped_s = time.monotonic()
    wait(supervisor, lambda: PartEventKind.FAILED in kinds(events))
    assert time.monotonic() - stopped_s > 2.0
    assert events[2].cause is Cause.SILENT


@pytest.mark.slow
def test_process_that_fails_again_and_again_is_given_up(run) -> None:
    supervisor, events = run(WRONG)
    wait(supervisor, lambda: supervisor.given_up)
    assert supervisor.lost == "hub"
    assert kinds(events) == ["started", "failed", "started", "failed", "started", "given_up"]
    said = "'nowhere' is not an endpoint: expected something like tcp/127.0.0.1:7447"
    assert events[-1].words == f"hub ended with status 2 ({said}) and is given up: it has failed too often"


@pytest.mark.slow
def test_refusal_of_a_part_that_must_start_is_an_error_of_whoever_started_it(run) -> None:
    supervisor, _ = run(WRONG, must_start=True)
    with pytest.raises(ChildFailed, match="the hub did not start: 'nowhere' is not an endpoint"):
        wait(supervisor, lambda: False)


def test_guard_ends_what_is_left_even_if_it_stands_still() -> None:
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"], start_new_session=True)
    os.kill(child.pid, signal.SIGSTOP)
    began_s = time.monotonic()
    guard.end_groups({child.pid}, grace_s=0.1)
    assert child.wait(10) == -signal.SIGKILL
    assert time.monotonic() - began_s < 5.0


def test_guard_waits_for_those_that_end_by_themselves() -> None:
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(0.2)"], start_new_session=True)
    status: list[int] = []

    def look() -> None:
        status.append(child.wait())

    import threading

    waiting = threading.Thread(target=look)
    waiting.start()
    guard.end_groups({child.pid}, grace_s=30.0)
    waiting.join()
    assert status == [0]
