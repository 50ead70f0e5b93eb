"""A copy of a journal is made where there is room for it, and nowhere else."""

import shutil
from types import SimpleNamespace

import pytest

from robrain.coordinator.journal.errors import JournalError
from robrain.coordinator.journal.salvage import LEFT_BYTES, journal_copy


@pytest.fixture
def path(tmp_path, monkeypatch):
    (tmp_path / "memory").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "memory"))
    found = tmp_path / "team.journal"
    found.write_bytes(b"x" * 1000)
    found.with_name("team.journal-wal").write_bytes(b"y" * 500)
    found.with_name("team.journal-shm").write_bytes(b"z")
    return found


def rooms(monkeypatch, **free_bytes):
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=free_bytes[folder.name]))


def test_the_copy_has_the_log_beside_it_and_is_removed(path):
    with journal_copy(path) as copy:
        assert copy.read_bytes() == path.read_bytes()
        assert sorted(file.name for file in copy.parent.iterdir()) == ["journal", "journal-wal"]
    assert not copy.parent.exists()


@pytest.mark.parametrize(("memory_bytes", "is_there"), [(1500 + LEFT_BYTES, True), (1499 + LEFT_BYTES, False)])
def test_it_stands_beside_the_journal_where_temporary_files_have_no_room(path, monkeypatch, memory_bytes, is_there):
    rooms(monkeypatch, **{"memory": memory_bytes, path.parent.name: 1500 + LEFT_BYTES})
    with journal_copy(path) as copy:
        assert (copy.parent.parent == path.parent / "memory") is is_there
        assert copy.parent.parent in (path.parent / "memory", path.parent)


def test_without_room_nothing_is_written_and_it_is_said_where(path, monkeypatch):
    rooms(monkeypatch, **{"memory": 0, path.parent.name: 1499 + LEFT_BYTES})
    with (
        pytest.raises(JournalError, match=r"team.journal: a copy to read needs 0 MB.*set TMPDIR"),
        journal_copy(path),
    ):
        pass
    there = sorted(file.name for file in path.parent.iterdir())
    assert there == ["memory", "team.journal", "team.journal-shm", "team.journal-wal"]
