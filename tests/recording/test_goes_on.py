"""A later file of a recording, after a split or when a full disk has room again: it begins with the whole known map."""

import errno
import json
import os
from collections.abc import Iterator
from io import FileIO
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import zenoh
from mcap.reader import make_reader

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import LogRecord
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.table.topics import RECORDER_STATE, ROBOT_LOG, ROBOT_MAP
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.recording.provenance import Provenance
from robrain.recording.reader.checking import check_recording
from robrain.recording.reader.reading import read_messages
from robrain.recording.replay.player import Player
from robrain.recording.writer import recording_file, recording_files
from robrain.recording.writer.recorder import Recorder
from robrain.recording.writer.recording_files import SplitAt

PROVENANCE = Provenance("office", "x = 1\n", 7, None, "lockstep", "default")
GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 60, 40)


class Stage:
    """A robot that maps a strip of floor each tenth of a second, and says something nobody can compress."""

    def __init__(self, session: zenoh.Session) -> None:
        self.clock = VirtualClock(to_ns(5.0))
        self.wire = Endpoint(session, "default", self.clock, Drive.LOCKSTEP)
        self.told = Inbox(every=True)
        self.wire.subscribe(self.told, RECORDER_STATE)
        self.maps = self.wire.publisher(ROBOT_MAP, robot="r1")
        self.logs = self.wire.publisher(ROBOT_LOG, robot="r1")
        self.said = 0

    def run(self, recorder: Recorder, steps: int) -> None:
        for _ in range(steps):
            column = self.said % GEOMETRY.width
            cells = np.full((GEOMETRY.height, 1), 100 if self.said % 7 == 0 else 0, np.int8)
            self.maps.put(to_message("r1", GEOMETRY, PatchCells(0, column, cells, self.clock.now_ns() // 1_000_000)))
            self.logs.put(LogRecord(robot="r1", level="info", source="test", text=os.urandom(300).hex()))
            self.said += 1
            self.clock.advance_to(self.clock.now_ns() + to_ns(0.1))
            recorder.step()


class FullDisk(FileIO):
    """A disk with room for so many bytes, until somebody makes more."""

    room_bytes = 10**9

    def write(self, data: Any) -> int:
        if FullDisk.room_bytes < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        FullDisk.room_bytes -= len(data)
        return super().write(data)


class Room(NamedTuple):
    free: int


@pytest.fixture(scope="module")
def session() -> Iterator[zenoh.Session]:
    with open_lockstep_session() as session:
        yield session


@pytest.fixture
def stage(session: zenoh.Session, monkeypatch: pytest.MonkeyPatch) -> Iterator[Stage]:
    monkeypatch.setattr(recording_file, "open_file", lambda path: FullDisk(path, "w"))
    monkeypatch.setattr(FullDisk, "room_bytes", 10**9)
    stage = Stage(session)
    yield stage
    stage.wire.close()


def known_at_the_end(path: Path) -> Any:
    player = Player(path)
    try:
        grid = player.map_at(player.duration_s)
    finally:
        player.close()
    assert grid is not None
    return grid.classes()


def part_told(path: Path) -> dict[str, str]:
    with path.open("rb") as stream:
        told = {record.name: record.metadata for record in make_reader(stream).iter_metadata()}
    return told["robrain.part"]


@pytest.mark.parametrize("visual", [False, True])
def test_each_part_shows_the_whole_map_alone(stage: Stage, tmp_path: Path, visual: bool) -> None:
    recorder = Recorder(stage.wire, tmp_path / "run.mcap", PROVENANCE, split=SplitAt(duration_s=1.7), visual=visual)
    stage.run(recorder, 60)
    parts = recorder.close().paths
    assert len(parts) >= 3
    shown = known_at_the_end(parts[-1])
    assert (shown != -1).all()
    assert [(shown[0, column] == 100) for column in range(60)] == [column % 7 == 0 for column in range(60)]
    for before, part in pairwise(parts):
        first = next(message for message in read_messages(part) if message.topic_key.endswith("/map"))
        assert first.topic_key == "robrain/default/robot/rec_run/map"  # not r1: it did not say so
        assert (known_at_the_end(part) != -1).sum() > (known_at_the_end(before) != -1).sum()
        assert check_recording(part).good


def test_the_map_at_the_front_is_not_in_the_digest(session: zenoh.Session, tmp_path: Path) -> None:
    digests = set()
    for name, split in (("one", SplitAt()), ("many", SplitAt(duration_s=1.0))):
        stage = Stage(session)
        recorder = Recorder(stage.wire, tmp_path / f"{name}.mcap", PROVENANCE, split=split)
        for _ in range(30):
            cells = np.zeros((4, 4), np.int8)
            stage.maps.put(to_message("r1", GEOMETRY, PatchCells(0, 0, cells, stage.clock.now_ns() // 1_000_000)))
            stage.clock.advance_to(stage.clock.now_ns() + to_ns(0.1))
            recorder.step()
        digests.add((recorder.close().digest, recorder.messages))
        stage.wire.close()
    assert len(digests) == 1


def test_a_recording_goes_on_in_a_second_file_when_there_is_room_again(stage: Stage, tmp_path: Path) -> None:
    recorder = Recorder(stage.wire, tmp_path / "run.mcap", PROVENANCE)
    stage.run(recorder, 30)
    FullDisk.room_bytes = 0
    stage.run(recorder, 100)
    FullDisk.room_bytes = 10**9
    stage.run(recorder, 100)
    summary = recorder.close()
    assert [path.name for path in summary.paths] == ["run.mcap", "run_0002.mcap"]
    assert sorted(tmp_path.iterdir()) == sorted(summary.paths)
    kept = sum(1 for path in summary.paths for m in read_messages(path) if "/robot/r1/" in m.topic_key)
    assert kept + summary.lost == summary.messages == 460
    assert 0 < summary.lost < 360
    told = part_told(summary.paths[1])
    assert told["part"] == "2"
    assert json.loads(told["lost_before"]) == summary.lost_by_topic
    assert (known_at_the_end(summary.paths[1]) != -1).all()  # with what was lost on the way
    whys = [received.message.why for received in stage.told.drain()]
    assert "No space left" in whys[0]
    assert whys[-1] == ""


def test_a_disk_that_stays_full_is_left_alone(stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = Recorder(stage.wire, tmp_path / "run.mcap", PROVENANCE)
    stage.run(recorder, 30)
    FullDisk.room_bytes = 0
    stage.run(recorder, 20)
    FullDisk.room_bytes = 10**9
    monkeypatch.setattr(recording_files.shutil, "disk_usage", lambda _folder: Room(recording_files.ROOM_BYTES - 1))
    stage.run(recorder, 200)
    assert [path.name for path in recorder.close().paths] == ["run.mcap"]


def test_files_that_end_before_their_first_message_are_not_heaped_up(stage: Stage, tmp_path: Path) -> None:
    recorder = Recorder(stage.wire, tmp_path / "run.mcap", PROVENANCE)
    stage.run(recorder, 30)
    for _ in range(5):
        FullDisk.room_bytes = 3000  # enough for the front of a file, and for nothing behind it
        stage.run(recorder, 60)
    FullDisk.room_bytes = 10**9
    stage.run(recorder, 100)
    summary = recorder.close()
    assert [path.name for path in summary.paths] == ["run.mcap", "run_0002.mcap"]
    assert sorted(tmp_path.iterdir()) == sorted(summary.paths)
    kept = sum(1 for path in summary.paths for m in read_messages(path) if "/robot/r1/" in m.topic_key)
    assert kept + summary.lost == summary.messages
    assert summary.bytes == sum(path.stat().st_size for path in summary.paths)


def test_a_file_of_somebody_else_is_stepped_over(stage: Stage, tmp_path: Path) -> None:
    (tmp_path / "run_0002.mcap").write_bytes(b"mine")
    recorder = Recorder(stage.wire, tmp_path / "run.mcap", PROVENANCE)
    stage.run(recorder, 20)
    FullDisk.room_bytes = 0
    stage.run(recorder, 20)
    FullDisk.room_bytes = 10**9
    stage.run(recorder, 100)
    assert [path.name for path in recorder.close().paths] == ["run.mcap", "run_0003.mcap"]
    assert (tmp_path / "run_0002.mcap").read_bytes() == b"mine"
