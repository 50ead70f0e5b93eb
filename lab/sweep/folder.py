"""The folder of a sweep: the journal of its runs, which survives a kill, and the files that are written at the end."""

import fcntl
import os
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec

from robrain.deploy.errors import SweepError
from robrain.lab.sweep.run_outcome import RunRecord

JOURNAL = "runs.jsonl"
MANIFEST = "sweep.json"
RECORDINGS = "recordings"
SETTINGS = "settings"


class SweepIdentity(msgspec.Struct, frozen=True, kw_only=True):
    """Identity that two calls must share to continue the same sweep."""

    scenario: str
    seeds: str
    varied: dict[str, str]
    settings: dict[str, str]
    """SHA-256 of each setting's scenario file, by the setting's label."""
    inputs: dict[str, str]
    record: bool
    versions: dict[str, str]


class SweepFolder:
    """The folder, held by one process at a time; use it in a `with` block.

    The journal has a line for each run that has ended, written and synced before the next one. A line that a kill cut
    off is dropped when the journal is opened again.

    Args:
        path: made if it is not there.
        identity: must equal that of the sweep that is there.

    Raises:
        SweepError: another sweep is there, another process uses it, or it cannot be read or written.

    """

    def __init__(self, path: Path, identity: SweepIdentity) -> None:
        self.path = path
        self.records: dict[str, RunRecord] = {}
        """The last record of each run that has ended, by its name."""
        try:
            if path.exists() and not (path / JOURNAL).exists() and any(path.iterdir()):
                raise SweepError(f"{path}: it holds other files; give an empty or a new folder with --output")
            path.mkdir(parents=True, exist_ok=True)
            self._journal = (path / JOURNAL).open("a+b")
        except OSError as error:
            raise SweepError(f"{path}: cannot be used: {error.strerror or error}") from error
        try:
            self._lock()
            self._check(identity)
            self._read()
        except BaseException:
            self._journal.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._journal.close()

    def add(self, record: RunRecord) -> None:
        """Keep a record; it is on the disk when this returns (SweepError if it cannot be written)."""
        try:
            self._journal.write(msgspec.json.encode(record) + b"\n")
            self._journal.flush()
            os.fsync(self._journal.fileno())
        except OSError as error:
            raise SweepError(f"{self.path / JOURNAL}: cannot be written: {error.strerror or error}") from error
        self.records[record.run] = record

    def write(self, name: str, data: bytes) -> Path:
        """Write a file whole or not at all (SweepError); returns its path."""
        path = self.path / name
        part = path.with_name(f".{path.name}.part")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(data)
            part.replace(path)
        except OSError as error:
            raise SweepError(f"{path}: cannot be written: {error.strerror or error}") from error
        return path

    def write_json(self, name: str, value: object) -> Path:
        """Write a value as indented JSON (SweepError); returns the path."""
        return self.write(name, msgspec.json.format(msgspec.json.encode(value, enc_hook=str), indent=2) + b"\n")

    def _lock(self) -> None:
        try:
            fcntl.flock(self._journal, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise SweepError(f"{self.path}: another sweep is running in it") from error

    def _check(self, identity: SweepIdentity) -> None:
        """Compare with the sweep that is there; the identity is the journal's first line."""
        self._journal.seek(0)
        first = self._journal.readline()
        if not first.endswith(b"\n"):
            self._journal.truncate(0)
            self._journal.write(msgspec.json.encode(identity) + b"\n")
            self._journal.flush()
            return
        try:
            there = msgspec.json.decode(first, type=SweepIdentity)
        except msgspec.DecodeError as error:
            raise SweepError(f"{self.path / JOURNAL}: line 1 is not that of a sweep: {error}") from error
        if difference := _difference(msgspec.to_builtins(there), msgspec.to_builtins(identity)):
            raise SweepError(
                f"{self.path}: it holds another sweep: {difference}; give another folder with --output, or move it away"
            )

    def _read(self) -> None:
        """Read the records; the journal stands at the end of the first line afterwards, or is empty."""
        self._journal.seek(0)
        self._journal.readline()
        end = self._journal.tell()
        for number, line in enumerate(self._journal, 2):
            if not line.endswith(b"\n"):
                self._journal.truncate(end)
                break
            end += len(line)
            try:
                record = msgspec.json.decode(line, type=RunRecord)
            except msgspec.DecodeError as error:
                raise SweepError(f"{self.path / JOURNAL}: line {number} is damaged: {error}") from error
            self.records[record.run] = record
        self._journal.seek(0, os.SEEK_END)


def _difference(there: Mapping[str, Any], now: Mapping[str, Any], path: str = "") -> str:
    """The first value that differs, in words; empty if none does."""
    for key in (*there, *(key for key in now if key not in there)):
        one, other = there.get(key), now.get(key)
        if one == other:
            continue
        name = f"{path} {key}".strip()
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            return _difference(one, other, name)
        return f"{name} was {_text(one)} and is now {_text(other)}"
    return ""


def _text(value: object) -> str:
    return "not given" if value is None else str(value)
