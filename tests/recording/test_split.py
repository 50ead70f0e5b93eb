"""A recording in several files; what is lost is counted by topic, told on the wire and written down."""

import errno
import logging
import os
from collections.abc import Iterator
from io import FileIO
from pathlib import Path
from typing import Any

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import LogRecord
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.team.recorder_messages import LostMessages, RecorderState
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.table.topics import RECORDER_STATE, ROBOT_LOG, ROBOT_STATE
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.recording.errors import RecordingError
from robrain.recording.foxglove.channels import FoxgloveChannels
from robrain.recording.foxglove.visual_topics import is_visual
from robrain.recording.provenance import Provenance
from robrain.recording.reader.checking import check_recording
from robrain.recording.reader.reading import read_messages, read_provenance
from robrain.recording.writer import recording_file
from robrain.recording.writer import rotation as rotation_module
from robrain.recording.writer.recorder import Recorder, RecorderInbox
from robrain.recording.writer.recording_files import SplitAt
from robrain.recording.writer.rotation import KeepFiles, Rotation, own_recordings

PROVENANCE = Provenance("office", "x = 1\n", 7, b"\x89PNG", "lockstep", "default", {"robots/r1.toml": "[robot]\n"})


class Stage:
    def __init__(self, session: zenoh.Session) -> None:
        self.clock = VirtualClock(to_ns(5.0))
        self.wire = Endpoint(session, "default", self.clock, Drive.LOCKSTEP)
        self.ear = Endpoint(session, "default", self.clock, Drive.LOCKSTEP)
        self.told = Inbox(every=True)
        self.ear.subscribe(self.told, RECORDER_STATE)
        self.logs = self.ear.publisher(ROBOT_LOG, robot="r1")
        self.states = self.ear.publisher(ROBOT_STATE, robot="r1")

    def recorder(self, path: Path, **options: Any) -> Recorder:
        return Recorder(self.wire, path, PROVENANCE, **options)

    def say_for(self, recorder: Recorder, steps: int) -> None:
        for _ in range(steps):
            self.logs.put(LogRecord(robot="r1", level="info", source="s", text=os.urandom(100).hex()))
            self.states.put_bytes(b'{"robot":"r1"}')
            self.clock.advance_to(self.clock.now_ns() + to_ns(0.1))
            recorder.step()

    def told_states(self) -> list[RecorderState]:
        return [received.message for received in self.told.drain()]

    def close(self) -> None:
        self.wire.close()
        self.ear.close()


@pytest.fixture(scope="module")
def session() -> Iterator[zenoh.Session]:
    with open_lockstep_session() as session:
        yield session


@pytest.fixture
def stage(session: zenoh.Session) -> Iterator[Stage]:
    stage = Stage(session)
    yield stage
    stage.close()


def metadata(path: Path) -> dict[str, dict[str, str]]:
    with path.open("rb") as stream:
        return {record.name: record.metadata for record in make_reader(stream).iter_metadata()}


@pytest.mark.parametrize("split", [SplitAt(duration_s=2.0), SplitAt(size_bytes=8000)])
def test_each_part_is_whole_and_together_they_hold_everything(stage: Stage, tmp_path: Path, split: SplitAt) -> None:
    recorder = stage.recorder(tmp_path / "run.mcap", split=split)
    stage.say_for(recorder, 100)
    summary = recorder.close()
    assert [path.name for path in summary.paths] == [f"run_{n:04d}.mcap" for n in range(1, len(summary.paths) + 1)]
    assert len(summary.paths) >= 4
    counts = []
    times_ns = [message.log_time_ns for path in summary.paths for message in read_messages(path)]
    assert times_ns == sorted(times_ns)
    for number, path in enumerate(summary.paths, 1):
        assert read_provenance(path) == PROVENANCE
        told = metadata(path)
        counts.append(sum(1 for _ in read_messages(path)))
        assert told["robrain.part"] == {"part": str(number)}
        assert told["robrain.summary"]["part_messages"] == str(counts[-1])
    assert sum(counts) == summary.messages == 200
    assert summary.bytes == sum(path.stat().st_size for path in summary.paths)
    assert metadata(summary.paths[-1])["robrain.summary"]["digest"] == summary.digest


def test_a_part_that_holds_only_what_is_drawn_is_good(stage: Stage, tmp_path: Path) -> None:
    recorder = stage.recorder(tmp_path / "run.mcap", split=SplitAt(duration_s=1.0), visual=True)
    for received in (True, False):
        if received:
            stage.states.put(RobotState(robot="r1", pose=Pose2D(1.0, 0.0, 0.0)))
        stage.clock.advance_to(stage.clock.now_ns() + to_ns(1.1))
        recorder.step()
    *_, last = recorder.close().paths
    assert all(is_visual(message.topic_key) for message in read_messages(last))
    assert check_recording(last).good


def test_a_part_that_exists_already_is_not_overwritten(stage: Stage, tmp_path: Path) -> None:
    (tmp_path / "run_0001.mcap").write_bytes(b"old")
    with pytest.raises(RecordingError, match="exists already"):
        stage.recorder(tmp_path / "run.mcap", split=SplitAt(duration_s=1.0))
    assert (tmp_path / "run_0001.mcap").read_bytes() == b"old"


@pytest.mark.parametrize("wrong", [{"size_bytes": 0}, {"size_bytes": -1}, {"duration_s": 0.0}, {"duration_s": -2.0}])
def test_a_split_that_makes_no_sense_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="expected"):
        SplitAt(**wrong)


class FullDisk(FileIO):
    """A disk with room for so many bytes, until somebody makes more."""

    room_bytes = 0

    def write(self, data: Any) -> int:
        if FullDisk.room_bytes < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        FullDisk.room_bytes -= len(data)
        return super().write(data)


def test_what_a_full_disk_loses_is_counted_by_topic_and_told_on_the_wire(
    stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(recording_file, "open_file", lambda path: FullDisk(path, "w"))
    monkeypatch.setattr(FullDisk, "room_bytes", 6000)
    recorder = stage.recorder(tmp_path / "run.mcap")
    with caplog.at_level(logging.ERROR):
        stage.say_for(recorder, 100)
        summary = recorder.close()
    kept = [message.topic_key for message in read_messages(tmp_path / "run.mcap")]
    states, logs = (sum(key.endswith(end) for key in kept) for end in ("/state", "/log"))
    assert summary.lost_by_topic == {"robot_log": 100 - logs, "robot_state": 100 - states}
    assert "No space left" in caplog.text
    told = stage.told_states()
    assert "No space left" in told[0].why
    assert told[-1].lost == [LostMessages("robot_log", 100 - logs), LostMessages("robot_state", 100 - states)]


def test_nothing_is_told_in_lockstep_as_long_as_nothing_is_lost(stage: Stage, tmp_path: Path) -> None:
    recorder = stage.recorder(tmp_path / "run.mcap")
    stage.say_for(recorder, 30)
    assert stage.told_states() == []
    recorder.close()
    [state] = stage.told_states()
    assert (state.closed, state.messages, state.lost, state.file) == (True, 60, [], "run.mcap")


def test_what_cannot_be_drawn_is_recorded_all_the_same(
    stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(_channels: FoxgloveChannels, _now_ns: int) -> Iterator[Any]:
        raise ValueError("no such colour")

    monkeypatch.setattr(FoxgloveChannels, "due", fail)
    recorder = stage.recorder(tmp_path / "run.mcap", visual=True)
    stage.say_for(recorder, 20)
    assert recorder.close().messages == 40
    assert sum(1 for _ in read_messages(tmp_path / "run.mcap")) == 40
    assert len(caplog.records) == 1


@given(st.lists(st.tuples(st.sampled_from([ROBOT_LOG, ROBOT_STATE]), st.integers(0, 60)), max_size=40))
def test_a_full_inbox_keeps_the_first_messages_and_counts_the_rest_by_topic(said: list[tuple[Any, int]]) -> None:
    inbox = RecorderInbox(capacity=8, capacity_bytes=100)
    for topic, size in said:
        inbox.append(topic, "key", bytes(size))
    kept = inbox.drain_raw()
    assert len(kept) <= 8
    assert sum(len(payload) for _, _, payload in kept) <= 100
    assert len(kept) + inbox.dropped == len(said) == inbox.received
    assert sum(inbox.dropped_by_topic.values()) == inbox.dropped
    for topic in (ROBOT_LOG, ROBOT_STATE):
        there = sum(kept_topic is topic for kept_topic, _, _ in kept)
        assert there + inbox.dropped_by_topic[topic.name] == sum(said_topic is topic for said_topic, _ in said)
    inbox.append(ROBOT_LOG, "key", b"x" * 100)
    assert len(inbox.drain_raw()) == 1


def test_bytes_that_arrive_while_an_inbox_is_emptied_are_counted() -> None:
    inbox = RecorderInbox(capacity=100, capacity_bytes=100)

    class Measured(bytes):
        """While the recorder's thread measures it, another message arrives on a thread of the wire."""

        def __len__(self) -> int:
            if not inbox._every:
                inbox.append(ROBOT_LOG, "key", b"x" * 60)
            return 10

    inbox._every.append((ROBOT_LOG, "key", Measured()))
    inbox._bytes = 10
    inbox.drain_raw()
    inbox.append(ROBOT_LOG, "key", b"x" * 60)
    assert (len(inbox), inbox.dropped) == (1, 1)
    inbox.drain_raw()
    inbox.append(ROBOT_LOG, "key", b"x" * 100)
    assert (len(inbox), inbox.dropped) == (1, 1)


def test_recorder_that_rotates_removes_older_recordings_and_counts_them(
    stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rotation_module, "YOUNG_S", 0.0)  # the run's clock is not that of the files
    old = tmp_path / "depot-1.mcap"
    old.write_bytes(b"old")
    os.utime(old, ns=(0, 0))
    path = tmp_path / "depot-2.mcap"
    series = own_recordings(path, is_given=False)
    recorder = Recorder(stage.wire, path, PROVENANCE, rotation=Rotation(tmp_path, series, KeepFiles(size_bytes=1)))
    stage.say_for(recorder, 10)
    summary = recorder.close()
    assert not old.exists()
    assert summary.removed == 1
    assert summary.paths == [path]
    assert sum(1 for _ in read_messages(path)) == 20
