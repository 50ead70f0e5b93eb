"""Every call of an assistant as one line of JSON in a file that does not grow without end."""

import os
from pathlib import Path
from typing import BinaryIO

import msgspec

from robrain.deploy.assistant.policy import AuditError
from robrain.protocol.model.ranges import cut

FILE_BYTES = 4_194_304
FILES = 4
"""Files that are kept: the present one and `.1` to `.3`, the last of which is the oldest."""
ARGUMENTS_MAX, TEXT_MAX, NAME_MAX = 1000, 500, 100
"""Longest arguments, words and names, characters."""
OWNER_ONLY = 0o600


class AuditRecord(msgspec.Struct, frozen=True, kw_only=True):
    """One call."""

    stamp: str
    """Time of the answer, ISO 8601, UTC."""
    call: int
    """Number of the call since the start of this process; an order that is carried out has two lines."""
    by: str
    """Identity of the requester, as the team sees it."""
    client: str
    """Name and version that the MCP client gives of itself."""
    tool: str
    arguments: str
    """As JSON, cut."""
    verdict: str
    code: str = ""
    """Reason for its refusal."""
    words: str = ""
    """The first words of the answer."""
    duration_ms: float = 0.0


class AuditLog:
    """Writes the log; close it.

    Args:
        path: of the present file; only its owner may read it.

    Raises:
        AuditError: it cannot be opened.

    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: BinaryIO | None = None
        try:
            self._open()
        except OSError as error:
            raise AuditError(path, error) from error

    def write(self, record: AuditRecord) -> None:
        """Append a record; on disk when this returns (AuditError if it cannot be)."""
        line = msgspec.json.encode(_bounded(record)) + b"\n"
        try:
            if self._file is None:
                self._open()
            assert self._file is not None
            if self._file.tell() + len(line) > FILE_BYTES and self._file.tell():
                self._rotate()
            self._file.write(line)
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            self.close()  # the next record tries again
            raise AuditError(self.path, error) from error

    def close(self) -> None:
        """Close the file."""
        file, self._file = self._file, None
        if file is not None:
            try:
                file.close()
            except OSError:  # a full disk: the record was refused already
                return

    def _open(self) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, OWNER_ONLY)
        self._file = os.fdopen(handle, "ab")

    def _rotate(self) -> None:
        self.close()
        for number in range(FILES - 1, 0, -1):
            earlier = self.path if number == 1 else self._numbered(number - 1)
            if earlier.exists():
                earlier.replace(self._numbered(number))
        self._open()

    def _numbered(self, number: int) -> Path:
        return self.path.with_name(f"{self.path.name}.{number}")


def _bounded(record: AuditRecord) -> AuditRecord:
    return msgspec.structs.replace(
        record,
        client=cut(record.client, NAME_MAX),
        tool=cut(record.tool, NAME_MAX),
        arguments=cut(record.arguments, ARGUMENTS_MAX),
        words=cut(record.words, TEXT_MAX),
    )
