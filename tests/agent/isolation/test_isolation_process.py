"""The process of an isolated plugin: it is told as lost only when it ends of itself."""

import os
import signal
import socket
import threading
import time
import weakref
from collections.abc import Iterator, Sequence
from typing import Any

import msgspec
import pytest

from robrain.agent.board import Board
from robrain.agent.isolation import isolated_plugin
from robrain.agent.isolation.child import ChildEnvironment, RemoteBoard
from robrain.agent.isolation.contract import decoder
from robrain.agent.isolation.isolated_plugin import ChildProcess
from robrain.agent.isolation.messages import BOARD_TYPES, Begin, CallRequest, Get, ReadBoard, WriteBoard
from robrain.agent.isolation.peer import Peer, PeerLate
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.wire.session import listening_at, open_session
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
    monkeypatch.setattr(isolated_plugin, "END_TIMEOUT_S", 0.05)
    os.kill(child.pid, signal.SIGSTOP)  # it does not end by itself
    assert callable(end)
    end(child)
    assert child._watcher.close(PATIENCE_S)
    assert watcher.told == []
    assert child.status == -signal.SIGKILL


def test_a_process_that_ends_of_itself_is_told_as_lost_once(child: ChildProcess, watcher: Watcher) -> None:
    os.kill(child.pid, signal.SIGTERM)
    assert watcher.heard.wait(PATIENCE_S)
    assert child.how_it_ended() == "was ended by SIGTERM"
    child.end()
    child.kill()
    assert watcher.told == ["was ended by SIGTERM"]


def environment_in_its_process(connect: Sequence[str] = ()) -> ChildEnvironment:
    """What the plugin has at hand in its own process; its parent is not asked for anything."""
    begin = Begin("r1", "default", "vision", "vision.toml", "vision:Vision", b"", (), list(connect), 0, [], 0)
    nobody: Any = None
    return ChildEnvironment(begin, nobody, threading.RLock())


def test_an_environment_that_has_used_the_wire_leaves_it_when_it_closes() -> None:
    with open_session(mode="router", listen=["tcp/127.0.0.1:0"]) as hub:
        environment = environment_in_its_process(connect=listening_at(hub))
        wire = environment.wire
        assert not wire.session.is_closed()
        environment.close()
        assert wire.is_closed
        assert wire.session.is_closed()


# -- the connection -------------------------------------------------------------------------------------------------

STEP_S = 0.05
LIMIT_S = 1.0
"""So long that the first questions arrive within it on a busy machine too."""


@pytest.mark.slow
def test_repeated_counter_questions_do_not_extend_the_time_limit():
    """Each of its questions arrives in time, but together they exceed the time limit."""
    near_end, far_end = socket.socketpair()
    asked_back = 0

    def serve_far(_request):
        while True:
            time.sleep(STEP_S)
            far.ask(Get(0, "pose"))

    def serve_near(_request):
        nonlocal asked_back
        asked_back += 1
        return b"1"

    near, far = Peer(near_end, "vision", serve_near), Peer(far_end, "vision", serve_far)
    thread = threading.Thread(target=far.run, name="far", daemon=True)
    thread.start()
    with pytest.raises(PeerLate):
        near.ask(CallRequest(0, "look", b""), LIMIT_S)
    assert asked_back > 1
    near.close()
    thread.join()
    far.close()


# -- the board ------------------------------------------------------------------------------------------------------


class Parent:
    """A new board: keeps what is written, as bytes, and gives it back as the robot's process does."""

    def __init__(self) -> None:
        self.board: dict[str, bytes] = {}

    def send(self, said: WriteBoard) -> None:
        self.board[said.name] = said.value
        decoder(BOARD_TYPES[said.name]).decode(said.value)  # as the robot's process reads it

    def ask(self, asked: ReadBoard) -> bytes:
        return self.board.get(asked.name) or msgspec.msgpack.encode(getattr(Board(), asked.name))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("odometry", ((20_000_000, Pose2D(1.0, 2.0, 0.5)), (40_000_000, Pose2D(1.1, 2.0, 0.5)))),
        ("published_odometry", (Pose2D(1.0, 2.0, 0.5), 7)),
        ("published_odometry", None),
        ("wants_odometry", True),
        ("gyro_contradiction", -1.0),
        ("wheel_ticks", (1, 2, 3)),
    ],
)
def test_what_devices_leave_on_the_board_is_the_same_on_both_sides(name: str, value: Any) -> None:
    parent: Any = Parent()
    board = RemoteBoard(parent)
    assert not getattr(board, name)
    setattr(board, name, value)
    assert getattr(board, name) == value
