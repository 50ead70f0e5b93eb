import errno
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from io import FileIO
from pathlib import Path
from typing import Any

import pytest
import zenoh
from mcap.reader import make_reader

from robrain.protocol.clock import VirtualClock
from robrain.protocol.messages.robots.plugin_messages import LogRecord
from robrain.protocol.table.topics import ROBOT_IMAGE, ROBOT_LOG
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.recording.errors import RecordingError
from robrain.recording.provenance import Provenance
from robrain.recording.reader.reading import read_messages, read_provenance
from robrain.recording.writer import recording_file
from robrain.recording.writer.recorder import Recorder, RecordingSummary

LINE = b'{"robot":"r1","level":"info","source":"s","text":"t"}'
PROVENANCE = Provenance("office", 'name = "office"\n', 7, b"\x89PNG", "lockstep", "default")


class Stage:
    """One session, a virtual clock, and a robot that logs."""

    def __init__(self, session: zenoh.Session) -> None:
        self.clock = VirtualClock()
        self.endpoint = Endpoint(session, "default", self.clock, Drive.LOCKSTEP)
        self.logs = self.endpoint.publisher(ROBOT_LOG, robot="r1")

    def recorder(self, path: Path | None) -> Recorder:
        return Recorder(self.endpoint, path, PROVENANCE)

    def pass_time(self, duration_ns: int) -> None:
        self.clock.advance_to(self.clock.now_ns() + duration_ns)


@pytest.fixture(scope="module")
def session() -> Iterator[zenoh.Session]:
    with open_lockstep_session() as session:
        yield session


@pytest.fixture
def stage(session: zenoh.Session) -> Iterator[Stage]:
    stage = Stage(session)
    yield stage
    stage.endpoint.close()


def record_a_run(session: zenoh.Session, path: Path | None, *, steps: int = 30) -> RecordingSummary:
    """A robot logs every 0.1 s."""
    stage = Stage(session)
    recorder = stage.recorder(path)
    for step in range(steps):
        stage.logs.put(LogRecord(robot="r1", level="info", source="test", text=f"step {step}"))
        recorder.step()
        stage.pass_time(100_000_000)
    summary = recorder.close()
    stage.endpoint.close()
    return summary


def test_messages_are_on_the_disk_after_half_a_second_of_the_runs_clock(stage: Stage, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorder = stage.recorder(path)
    stage.logs.put_bytes(LINE)
    recorder.step()
    opened_bytes = path.stat().st_size
    stage.pass_time(499_999_999)
    recorder.step()
    assert path.stat().st_size == opened_bytes
    stage.pass_time(1)
    recorder.step()
    assert path.stat().st_size > opened_bytes
    recorder.close()


def test_a_wall_clock_that_is_set_back_does_not_stop_the_flushing(session: zenoh.Session, tmp_path: Path) -> None:
    class TurnedBack:
        offset_ns = 0

        def now_ns(self) -> int:
            return 10**18 - self.offset_ns

    path = tmp_path / "run.mcap"
    clock = TurnedBack()
    endpoint = Endpoint(session, "default", clock, Drive.LOCKSTEP)
    recorder = Recorder(endpoint, path, PROVENANCE)
    opened_bytes = path.stat().st_size
    clock.offset_ns = 3600 * 10**9
    endpoint.publisher(ROBOT_LOG, robot="r1").put_bytes(LINE)
    recorder.step()
    assert path.stat().st_size > opened_bytes
    recorder.close()
    endpoint.close()


def test_a_chunk_ends_when_it_is_full(stage: Stage, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorder = stage.recorder(path)
    images = stage.endpoint.publisher(ROBOT_IMAGE, robot="r1", image="i1")
    for _ in range(5):
        images.put_bytes(b" " * 500_000)
    recorder.close()
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) == 2


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("run.bag", "ends in .mcap"),
        ("run", "ends in .mcap"),
        ("folder.mcap", "is a folder"),
        ("missing/run.mcap", "no folder"),
        ("file/run.mcap", "no folder"),  # a file where the folder should be
        ("device.mcap", "not a regular file"),
        ("x" * 300 + ".mcap", "too long"),
    ],
)
def test_a_path_that_cannot_be_written_is_told_in_a_sentence_and_leaves_nothing(
    stage: Stage, tmp_path: Path, name: str, says: str
) -> None:
    (tmp_path / "folder.mcap").mkdir()
    (tmp_path / "file").touch()
    (tmp_path / "device.mcap").symlink_to("/dev/full")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(RecordingError, match=says) as caught:
        stage.recorder(tmp_path / name)
    assert caught.value.path == tmp_path / name
    assert str(tmp_path / name) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert sorted(tmp_path.rglob("*")) == before


class FullDisk(FileIO):
    """A file on a disk with little room, for all of its files together: it takes what fits, then no more."""

    room_bytes = 0

    def write(self, data: Any) -> int:
        fits = min(len(data), FullDisk.room_bytes)
        if not fits:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        FullDisk.room_bytes -= fits
        return super().write(data[:fits])


def with_room(monkeypatch: pytest.MonkeyPatch, room_bytes: int) -> None:
    monkeypatch.setattr(FullDisk, "room_bytes", room_bytes)
    monkeypatch.setattr(recording_file, "open_file", lambda path: FullDisk(path, "w"))


def test_a_disk_that_is_full_at_the_start_is_told_and_leaves_nothing(
    stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with_room(monkeypatch, 100)
    with pytest.raises(RecordingError, match="No space left"):
        stage.recorder(tmp_path / "run.mcap")
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_fills_up_is_told_once_and_the_run_goes_on(
    session: zenoh.Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    whole = record_a_run(session, None, steps=200)
    with_room(monkeypatch, 4000)
    path = tmp_path / "run.mcap"
    with caplog.at_level(logging.ERROR):
        summary = record_a_run(session, path, steps=200)
    assert [record.levelname for record in caplog.records] == ["ERROR"]
    assert "No space left" in caplog.text
    assert summary.messages == whole.messages
    assert summary.digest == whole.digest
    kept = sum(1 for _ in read_messages(path))
    assert 0 < kept < summary.messages
    assert kept + summary.lost == summary.messages
    assert summary.bytes == path.stat().st_size < 4000


def test_a_disk_that_fills_up_at_the_very_end_loses_no_message(
    session: zenoh.Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "run.mcap"
    whole = record_a_run(session, path)
    with_room(monkeypatch, whole.bytes - 1)
    with caplog.at_level(logging.ERROR):
        summary = record_a_run(session, path)
    assert summary.lost == 0
    assert sum(1 for _ in read_messages(path)) == summary.messages == whole.messages
    assert len(caplog.records) == 1


KILLED = """
import signal, sys
from pathlib import Path
from robrain.recording.provenance import Provenance
from robrain.recording.reader.reading import read_messages, read_provenance
from robrain.recording.writer.recorder import Recorder
from robrain.protocol.clock import VirtualClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.protocol.table.topics import ROBOT_LOG

clock = VirtualClock()
endpoint = Endpoint(open_lockstep_session(), "default", clock, Drive.LOCKSTEP)
recorder = Recorder(endpoint, Path(sys.argv[1]), Provenance("killed", "", 1, None, "lockstep", "default"))
logs = endpoint.publisher(ROBOT_LOG, robot="r1")
for step in range(1, 100):
    logs.put_bytes(b'{"robot":"r1","level":"info","source":"s","text":"t"}')
    clock.advance_to(step * 100_000_000)
    recorder.step()
print("recorded", flush=True)
signal.pause()
"""


@pytest.mark.slow
def test_a_killed_recorder_leaves_all_but_the_last_half_second(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with subprocess.Popen([sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"recorded\n"
        process.send_signal(signal.SIGKILL)
    assert 95 <= sum(1 for _ in read_messages(path)) <= 99
    assert read_provenance(path).scenario == "killed"
