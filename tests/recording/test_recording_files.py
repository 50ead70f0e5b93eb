"""The files of a recording: flushed, split, continued after a full disk; lost messages are counted and reported."""

import json
import logging
import signal
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.protocol.messages.robots.plugin_messages import ROBOT_LOG
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.recording.errors import RecordingError
from robrain.recording.foxglove.channels import FoxgloveChannels
from robrain.recording.reader.checking import check_recording
from robrain.recording.reader.reading import read_messages, read_provenance
from robrain.recording.replay.player import Player
from robrain.recording.writer import rotation as rotation_module
from robrain.recording.writer.recorder import Recorder, RecorderInbox, RecordingSummary
from robrain.recording.writer.recording_files import SplitAt
from robrain.recording.writer.rotation import KeepFiles, Rotation, own_recordings
from tests.recording.stage import LINE, PROVENANCE, FullDisk, Stage, metadata_of

GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 60, 40)
NOISE = np.random.default_rng(1)


def run_for(stage: Stage, recorder: Recorder, steps: int) -> None:
    """The robot logs text that cannot be compressed, and its state."""
    states = stage.speaker.publisher(ROBOT_STATE, robot="r1")
    for _ in range(steps):
        stage.log(NOISE.bytes(100).hex())
        states.put_bytes(b'{"robot":"r1"}')
        stage.pass_time()
        recorder.step()


def map_for(stage: Stage, recorder: Recorder, steps: int) -> None:
    """The robot maps a strip of floor each tenth of a second, with walls in some columns, and logs."""
    maps = stage.speaker.publisher(ROBOT_MAP, robot="r1")
    for _ in range(steps):
        column = round(stage.clock.now_ns() / 1e8) % GEOMETRY.width
        cells = np.full((GEOMETRY.height, 1), 100 if column % 7 == 0 else 0, np.int8)
        maps.put(to_message("r1", GEOMETRY, PatchCells(0, column, cells, stage.clock.now_ns() // 1_000_000)))
        stage.log(NOISE.bytes(300).hex())
        stage.pass_time()
        recorder.step()


def known_at_the_end(path: Path) -> Any:
    player = Player(path)
    grid = player.map_at(player.duration_s)
    player.close()
    assert grid is not None
    return grid.classes()


def of_the_robot(paths: list[Path]) -> int:
    return sum("/robot/r1/" in message.topic_key for path in paths for message in read_messages(path))


# -- one file ---------------------------------------------------------------------------------------------------


def record_logs(session: zenoh.Session, path: Path | None, *, steps: int = 30) -> RecordingSummary:
    stage = Stage(session)
    recorder = stage.recorder(path)
    for step in range(steps):
        stage.log(f"step {step}")
        recorder.step()
        stage.pass_time()
    summary = recorder.close()
    stage.close()
    return summary


def test_messages_are_on_the_disk_after_half_a_second_of_the_runs_clock(stage: Stage, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorder = stage.recorder(path)
    stage.logs.put_bytes(LINE)
    recorder.step()
    opened_bytes = path.stat().st_size
    stage.pass_time(0.499_999_999)
    recorder.step()
    assert path.stat().st_size == opened_bytes
    stage.pass_time(1e-9)
    recorder.step()
    assert path.stat().st_size > opened_bytes
    recorder.close()


@pytest.mark.parametrize(
    ("name", "reason"),
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
def test_path_that_cannot_be_written_is_refused_with_a_reason_and_leaves_nothing(
    stage: Stage, tmp_path: Path, name: str, reason: str
) -> None:
    (tmp_path / "folder.mcap").mkdir()
    (tmp_path / "file").touch()
    (tmp_path / "device.mcap").symlink_to("/dev/full")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(RecordingError, match=reason) as caught:
        stage.recorder(tmp_path / name)
    assert caught.value.path == tmp_path / name
    assert sorted(tmp_path.rglob("*")) == before


KILLED = """
import signal, sys
from pathlib import Path
from robrain.protocol.wire.session import open_lockstep_session
from tests.recording.stage import LINE, Stage

stage = Stage(open_lockstep_session())
recorder = stage.recorder(Path(sys.argv[1]))
for step in range(1, 100):
    stage.logs.put_bytes(LINE)
    stage.pass_time()
    recorder.step()
print("recorded", flush=True)
signal.pause()
"""


@pytest.mark.slow
def test_killed_recorder_leaves_all_but_the_last_half_second(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with subprocess.Popen([sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"recorded\n"
        process.send_signal(signal.SIGKILL)
    assert 95 <= sum(1 for _ in read_messages(path)) <= 99
    assert read_provenance(path) == PROVENANCE


# -- split ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("split", [SplitAt(duration_s=2.0), SplitAt(size_bytes=8000)])
def test_each_part_is_whole_and_together_they_hold_everything(stage: Stage, tmp_path: Path, split: SplitAt) -> None:
    recorder = stage.recorder(tmp_path / "run.mcap", split=split)
    run_for(stage, recorder, 100)
    summary = recorder.close()
    assert [path.name for path in summary.paths] == [f"run_{n:04d}.mcap" for n in range(1, len(summary.paths) + 1)]
    assert len(summary.paths) >= 4
    times_ns = [message.log_time_ns for path in summary.paths for message in read_messages(path)]
    assert times_ns == sorted(times_ns)
    counts = []
    for number, path in enumerate(summary.paths, 1):
        assert read_provenance(path) == PROVENANCE
        metadata = metadata_of(path)
        counts.append(sum(1 for _ in read_messages(path)))
        assert metadata["robrain.part"] == {"part": str(number)}
        assert metadata["robrain.summary"]["part_messages"] == str(counts[-1])
    assert sum(counts) == summary.messages == 200
    assert summary.bytes == sum(path.stat().st_size for path in summary.paths)
    assert metadata_of(summary.paths[-1])["robrain.summary"]["digest"] == summary.digest


@pytest.mark.parametrize("visual", [False, True])
def test_each_part_begins_with_the_whole_map(stage: Stage, tmp_path: Path, visual: bool) -> None:
    recorder = stage.recorder(tmp_path / "run.mcap", split=SplitAt(duration_s=1.7), visual=visual)
    map_for(stage, recorder, 60)
    parts = recorder.close().paths
    assert len(parts) >= 3
    shown = known_at_the_end(parts[-1])
    assert (shown != -1).all()
    assert [(shown[0, column] == 100) for column in range(60)] == [column % 7 == 0 for column in range(60)]
    for before, part in pairwise(parts):
        first = next(message for message in read_messages(part) if message.topic_key.endswith("/map"))
        assert first.topic_key == "robrain/default/robot/rec_run/map"  # not r1: it has not published it
        assert (known_at_the_end(part) != -1).sum() > (known_at_the_end(before) != -1).sum()
        assert check_recording(part).good


def test_map_at_the_front_is_not_in_the_digest(session: zenoh.Session, tmp_path: Path) -> None:
    digests = set()
    for name, split in (("one", SplitAt()), ("many", SplitAt(duration_s=1.0))):
        stage = Stage(session)
        recorder = stage.recorder(tmp_path / f"{name}.mcap", split=split)
        maps = stage.speaker.publisher(ROBOT_MAP, robot="r1")
        for step in range(30):
            maps.put(to_message("r1", GEOMETRY, PatchCells(0, 0, np.zeros((4, 4), np.int8), 100 * step)))
            stage.pass_time()
            recorder.step()
        digests.add((recorder.close().digest, recorder.messages))
        stage.close()
    assert len(digests) == 1


def test_recorder_that_rotates_removes_older_recordings_and_counts_them(
    stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rotation_module, "YOUNG_S", 0.0)  # the run's clock is not that of the files
    old = tmp_path / "depot-1.mcap"
    old.write_bytes(b"old")
    path = tmp_path / "depot-2.mcap"
    series = own_recordings(path, is_given=False)
    recorder = stage.recorder(path, rotation=Rotation(tmp_path, series, KeepFiles(size_bytes=1)))
    run_for(stage, recorder, 10)
    summary = recorder.close()
    assert not old.exists()
    assert (summary.removed, summary.paths) == (1, [path])
    assert sum(1 for _ in read_messages(path)) == 20


# -- a full disk ------------------------------------------------------------------------------------------------


def test_disk_that_is_full_at_the_start_is_refused_and_leaves_nothing(
    stage: Stage, tmp_path: Path, full_disk: type[FullDisk]
) -> None:
    full_disk.room_bytes = 100
    with pytest.raises(RecordingError, match="No space left"):
        stage.recorder(tmp_path / "run.mcap")
    assert list(tmp_path.iterdir()) == []


def test_disk_that_fills_up_is_logged_once_and_the_run_continues(
    session: zenoh.Session, tmp_path: Path, full_disk: type[FullDisk], caplog: pytest.LogCaptureFixture
) -> None:
    whole = record_logs(session, None, steps=200)
    full_disk.room_bytes = 4000
    path = tmp_path / "run.mcap"
    with caplog.at_level(logging.ERROR):
        summary = record_logs(session, path, steps=200)
    assert [record.levelname for record in caplog.records] == ["ERROR"]
    assert "No space left" in caplog.text
    assert (summary.messages, summary.digest) == (whole.messages, whole.digest)
    kept = sum(1 for _ in read_messages(path))
    assert 0 < kept < summary.messages
    assert kept + summary.lost == summary.messages
    assert summary.bytes == path.stat().st_size < 4000


def test_recording_continues_in_a_second_file_when_there_is_room_again(
    stage: Stage, tmp_path: Path, full_disk: type[FullDisk]
) -> None:
    recorder = stage.recorder(tmp_path / "run.mcap")
    map_for(stage, recorder, 30)
    full_disk.room_bytes = 0
    map_for(stage, recorder, 100)
    full_disk.room_bytes = 10**9
    map_for(stage, recorder, 100)
    summary = recorder.close()
    assert [path.name for path in summary.paths] == ["run.mcap", "run_0002.mcap"]
    assert sorted(tmp_path.iterdir()) == sorted(summary.paths)
    assert of_the_robot(summary.paths) + summary.lost == summary.messages == 460
    assert 0 < summary.lost < 360
    part = metadata_of(summary.paths[1])["robrain.part"]
    assert part["part"] == "2"
    assert json.loads(part["lost_before"]) == summary.lost_by_topic
    assert (known_at_the_end(summary.paths[1]) != -1).all()  # with what was lost on the way
    first, *_, last = stage.reported()
    assert "No space left" in first.why
    assert last.why == ""


def test_other_file_of_that_name_is_skipped(stage: Stage, tmp_path: Path, full_disk: type[FullDisk]) -> None:
    (tmp_path / "run_0002.mcap").write_bytes(b"mine")
    recorder = stage.recorder(tmp_path / "run.mcap")
    map_for(stage, recorder, 20)
    full_disk.room_bytes = 0
    map_for(stage, recorder, 20)
    full_disk.room_bytes = 10**9
    map_for(stage, recorder, 100)
    assert [path.name for path in recorder.close().paths] == ["run.mcap", "run_0003.mcap"]
    assert (tmp_path / "run_0002.mcap").read_bytes() == b"mine"


# -- reports and the inbox --------------------------------------------------------------------------------------


def test_messages_that_cannot_be_drawn_are_recorded(
    stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(_channels: FoxgloveChannels, _now_ns: int) -> Iterator[Any]:
        raise ValueError("no such colour")

    monkeypatch.setattr(FoxgloveChannels, "due", fail)
    recorder = stage.recorder(tmp_path / "run.mcap", visual=True)
    run_for(stage, recorder, 20)
    assert recorder.close().messages == 40
    assert sum(1 for _ in read_messages(tmp_path / "run.mcap")) == 40
    assert len(caplog.records) == 1


@given(st.lists(st.tuples(st.sampled_from([ROBOT_LOG, ROBOT_STATE]), st.integers(0, 60)), max_size=40))
def test_full_inbox_keeps_the_first_messages_and_counts_the_rest_by_topic(sent: list[tuple[Any, int]]) -> None:
    inbox = RecorderInbox(capacity=8, capacity_bytes=100)
    for topic, size in sent:
        inbox.append(topic, "key", bytes(size))
    kept = inbox.drain_raw()
    assert len(kept) <= 8
    assert sum(len(payload) for _, _, payload in kept) <= 100
    assert len(kept) + inbox.dropped == len(sent) == inbox.received
    assert sum(inbox.dropped_by_topic.values()) == inbox.dropped
    for topic in (ROBOT_LOG, ROBOT_STATE):
        there = sum(kept_topic is topic for kept_topic, _, _ in kept)
        assert there + inbox.dropped_by_topic[topic.name] == sum(sent_topic is topic for sent_topic, _ in sent)
    inbox.append(ROBOT_LOG, "key", b"x" * 100)
    assert len(inbox.drain_raw()) == 1


def test_bytes_that_arrive_while_an_inbox_is_drained_are_counted() -> None:
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


def test_part_that_exists_already_is_not_overwritten(stage: Stage, tmp_path: Path) -> None:
    (tmp_path / "run_0001.mcap").write_bytes(b"old")
    with pytest.raises(RecordingError, match="exists already"):
        stage.recorder(tmp_path / "run.mcap", split=SplitAt(duration_s=1.0))
    assert (tmp_path / "run_0001.mcap").read_bytes() == b"old"


def test_files_that_end_before_their_first_message_are_replaced(
    stage: Stage, tmp_path: Path, full_disk: type[FullDisk]
) -> None:
    recorder = stage.recorder(tmp_path / "run.mcap")
    map_for(stage, recorder, 30)
    for _ in range(5):
        full_disk.room_bytes = 3000  # enough for the front of a file, and for nothing behind it
        map_for(stage, recorder, 60)
    full_disk.room_bytes = 10**9
    map_for(stage, recorder, 100)
    summary = recorder.close()
    assert [path.name for path in summary.paths] == ["run.mcap", "run_0002.mcap"]
    assert sorted(tmp_path.iterdir()) == sorted(summary.paths)
    assert of_the_robot(summary.paths) + summary.lost == summary.messages
    assert summary.bytes == sum(path.stat().st_size for path in summary.paths)
