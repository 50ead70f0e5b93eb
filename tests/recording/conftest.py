from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from robrain.recording.writer import recording_file
from tests.recording.stage import FullDisk, Stage, depot_run


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recorded run, which no test changes."""
    path = tmp_path_factory.mktemp("depot") / "run.mcap"
    depot_run(path)
    return path


@pytest.fixture
def stage(session: zenoh.Session) -> Iterator[Stage]:
    stage = Stage(session)
    yield stage
    stage.close()


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> type[FullDisk]:
    """Recordings go to a disk whose `room_bytes` can be set."""
    monkeypatch.setattr(FullDisk, "room_bytes", 10**9)
    monkeypatch.setattr(recording_file, "open_file", lambda path: FullDisk(path, "w"))
    return FullDisk
