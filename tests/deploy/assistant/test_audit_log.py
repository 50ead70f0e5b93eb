"""The audit log: lines, bounds, rotation."""

import json
from pathlib import Path

import msgspec
import pytest

from robrain.deploy.assistant.audit_log import ARGUMENTS_MAX, AuditLog, AuditRecord
from robrain.deploy.assistant.policy import AuditError

RECORD = AuditRecord(
    stamp="2026-01-01T00:00:00.000+00:00", call=1, by="assistant:ann", client="scripted 1.0", tool="halt",
    arguments="{}", verdict="done",
)  # fmt: skip


def numbers(path: Path) -> list[int]:
    return [json.loads(line)["call"] for line in path.read_text().splitlines()]


def test_each_record_is_a_line_of_json_that_only_the_owner_may_read(tmp_path: Path) -> None:
    log = AuditLog(tmp_path / "deep" / "log.jsonl")
    log.write(RECORD)
    log.write(msgspec.structs.replace(RECORD, call=2, words="two\nlines"))
    log.close()
    assert numbers(log.path) == [1, 2]
    assert log.path.stat().st_mode & 0o777 == 0o600
    assert json.loads(log.path.read_text().splitlines()[0])["by"] == "assistant:ann"


def test_a_log_is_continued_by_the_next_process(tmp_path: Path) -> None:
    for call in (1, 2):
        log = AuditLog(tmp_path / "log.jsonl")
        log.write(msgspec.structs.replace(RECORD, call=call))
        log.close()
    assert numbers(tmp_path / "log.jsonl") == [1, 2]


def test_long_arguments_are_cut(tmp_path: Path) -> None:
    log = AuditLog(tmp_path / "log.jsonl")
    log.write(msgspec.structs.replace(RECORD, arguments="x" * 100_000, tool="y" * 100_000, client="z" * 100_000))
    log.close()
    found = json.loads(log.path.read_text())
    assert len(found["arguments"]) == ARGUMENTS_MAX
    assert log.path.stat().st_size < 2 * ARGUMENTS_MAX


def test_a_full_file_is_followed_by_the_next_and_the_oldest_is_gone(tmp_path: Path) -> None:
    line = len(msgspec.json.encode(RECORD)) + 1
    log = AuditLog(tmp_path / "log.jsonl", file_bytes=2 * line, files=3)
    for call in range(1, 10):
        log.write(msgspec.structs.replace(RECORD, call=call))
    log.close()
    assert numbers(tmp_path / "log.jsonl") == [9]
    assert numbers(tmp_path / "log.jsonl.1") == [7, 8]
    assert numbers(tmp_path / "log.jsonl.2") == [5, 6]
    assert len(list(tmp_path.iterdir())) == 3


def test_a_log_that_could_not_be_written_is_opened_again_for_the_next_record(tmp_path: Path) -> None:
    log = AuditLog(tmp_path / "log.jsonl")
    log.close()
    log.path.unlink()
    log.path.mkdir()
    with pytest.raises(AuditError):
        log.write(RECORD)
    log.path.rmdir()
    log.write(RECORD)
    log.close()
    assert numbers(log.path) == [1]
