"""The process of an isolated plugin: it is told as lost only when it ends of itself."""

import os
import signal
import threading
import weakref
from collections.abc import Iterator

import pytest

from robrain.agent.isolation.child_process import ChildProcess
from tests.waiting import PATIENCE_S


class Watcher:
    """Hears why a process was lost."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self.heard = threading.Event()

    def lost(self, why: str) -> None:
        self.told.append(why)
        self.heard.set()


@pytest.fixture
def watcher() -> Watcher:
    return Watcher()


@pytest.fixture
def child(watcher: Watcher) -> Iterator[ChildProcess]:
    child = ChildProcess("vision", lambda _request: b"", weakref.WeakMethod(watcher.lost))
    yield child
    child.kill()


@pytest.mark.parametrize("end", [ChildProcess.end, ChildProcess.kill, ChildProcess.how_it_ended])
def test_a_process_that_this_side_ends_is_not_told_as_lost(
    child: ChildProcess, watcher: Watcher, monkeypatch: pytest.MonkeyPatch, end: object
) -> None:
    monkeypatch.setattr(child._group, "wait", lambda _timeout_s: False)  # it does not end by itself
    os.kill(child.pid, signal.SIGSTOP)  # nor does it, however long this side takes
    assert callable(end)
    end(child)
    child._watcher.join(PATIENCE_S)
    assert not child._watcher.is_alive()
    assert watcher.told == []
    assert child._group.status == -signal.SIGKILL


def test_a_process_that_ends_of_itself_is_told_as_lost_once(child: ChildProcess, watcher: Watcher) -> None:
    os.kill(child.pid, signal.SIGTERM)
    assert watcher.heard.wait(PATIENCE_S)
    assert child.how_it_ended() == "was ended by SIGTERM"
    child.end()
    child.kill()
    assert watcher.told == ["was ended by SIGTERM"]


def test_nobody_needs_to_be_there_to_hear_of_a_loss(child: ChildProcess) -> None:
    child._on_lost = weakref.WeakMethod(Watcher().lost)
    os.kill(child.pid, signal.SIGKILL)
    child._watcher.join(PATIENCE_S)
    assert not child._watcher.is_alive()
    assert child._group.status == -signal.SIGKILL


def test_its_connections_are_given_back_once(child: ChildProcess) -> None:
    lifeline = child._lifeline
    child.kill()
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(lifeline)
    child.kill()
    assert child._lifeline == -1
