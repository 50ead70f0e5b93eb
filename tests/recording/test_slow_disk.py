"""A disk that takes nothing for a while: told while it lasts, nobody waits for it, and what is lost is counted."""

import threading
import time
from collections.abc import Callable, Iterator
from io import FileIO
from pathlib import Path
from typing import Any

import pytest

from robrain.protocol.clock import LiveClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.team.recorder_messages import RECORDER_STATE, RecorderState
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_session
from robrain.recording.provenance import Provenance
from robrain.recording.reader.reading import read_messages
from robrain.recording.writer import recorder as recorder_module
from robrain.recording.writer import recording_file
from robrain.recording.writer.recorder import Recorder
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.slow

PROVENANCE = Provenance("", "", 0, None, "live", "default")
CAPACITY = 200


class HungDisk(FileIO):
    """Takes nothing while the gate is shut."""

    gate = threading.Event()

    def write(self, data: Any) -> int:
        assert HungDisk.gate.wait(PATIENCE_S)
        return super().write(data)


class Team:
    """A recorder with a thread that steps it, and a robot in a session of its own that hears how it does."""

    def __init__(self, path: Path) -> None:
        self.hub = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
        self.recording = Endpoint(self.hub, "default", LiveClock(), Drive.LIVE)
        self.recorder = Recorder(self.recording, path, PROVENANCE)
        self.session = open_session(connect=listening_at(self.hub))
        self.robot = Endpoint(self.session, "default", LiveClock(), Drive.LIVE)
        self.states = self.robot.publisher(ROBOT_STATE, robot="r1")
        self.told = Inbox(every=True)
        self.robot.subscribe(self.told, RECORDER_STATE)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._steps)
        self._thread.start()

    def speak_until(self, done: Callable[[RecorderState], bool]) -> RecorderState:
        """Speak at about 500 Hz until a recorder says what is waited for."""
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            self.states.put_bytes(b'{"robot":"r1"}')
            time.sleep(0.002)
            for received in self.told.drain():
                if done(received.message):
                    state: RecorderState = received.message
                    return state
        raise AssertionError("the recorder never said so")

    def close(self) -> None:
        HungDisk.gate.set()
        self._stop.set()
        self._thread.join()
        self.recorder.close()
        for endpoint in (self.robot, self.recording):
            endpoint.close()
        self.session.close()
        self.hub.close()

    def _steps(self) -> None:
        while not self._stop.is_set():
            self.recorder.step()
            self._stop.wait(0.02)


@pytest.fixture
def team(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Team]:
    monkeypatch.setattr(recording_file, "open_file", lambda path: HungDisk(path, "w"))
    monkeypatch.setattr(recorder_module, "INBOX_CAPACITY", CAPACITY)
    HungDisk.gate.set()
    team = Team(tmp_path / "run.mcap")
    yield team
    team.close()


def test_nobody_waits_for_a_disk_that_hangs_which_is_told_and_what_is_lost_is_counted(
    team: Team, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    team.speak_until(lambda state: state.messages > 0)
    HungDisk.gate.clear()
    hanging = team.speak_until(lambda state: "nothing has been written for" in state.why)
    assert not hanging.closed
    ear = Inbox(every=True)
    team.robot.subscribe(ear, ROBOT_STATE)
    for _ in range(5 * CAPACITY):
        team.states.put_bytes(b'{"robot":"r1"}')
    until(lambda: len(ear) >= CAPACITY)  # by way of the hub, which the recorder's session is
    assert not HungDisk.gate.is_set()
    full = team.speak_until(lambda state: bool(state.lost) and "nothing has been written for" in state.why)
    assert full.waiting == CAPACITY
    assert "came faster than they are written" in full.why
    assert [lost.topic for lost in full.lost] == ["robot_state"]
    HungDisk.gate.set()
    team.speak_until(lambda state: "writing took" in state.why)
    good = team.speak_until(lambda state: "the disk" not in state.why)
    assert good.lost[0].messages >= full.lost[0].messages
    team.close()
    summary = team.recorder.close()
    kept = sum(1 for message in read_messages(tmp_path / "run.mcap"))
    assert kept == summary.messages
    assert summary.lost_by_topic == {"robot_state": summary.dropped}
    assert summary.dropped >= full.lost[0].messages
    assert caplog.text.count("has written nothing") == 1
