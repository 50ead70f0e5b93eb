"""Every call of an assistant as one line of JSON in a file that does not grow without end."""

import logging
import os
from contextlib import suppress
from functools import partial
from logging.handlers import RotatingFileHandler
from pathlib import Path
from typing import Any

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


class _OwnersFile(RotatingFileHandler):
    """A file that only its owner may read; the caller gets its errors."""

    def _open(self) -> Any:
        return open(self.baseFilename, "a", encoding="utf-8", opener=partial(os.open, mode=OWNER_ONLY))

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802
        """Raise the error that is being handled."""
        raise


class AuditLog:
    """Writes the log; close it.

    Args:
        path: of the present file; only its owner may read it.

    Raises:
        AuditError: it cannot be opened.

    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = _OwnersFile(path, maxBytes=FILE_BYTES + 1, backupCount=FILES - 1)
        except OSError as error:
            raise AuditError(path, error) from error

    def write(self, record: AuditRecord) -> None:
        """Append a record; on disk when this returns (AuditError if it cannot be)."""
        line = msgspec.json.encode(_bounded(record)).decode()
        try:
            self._file.emit(logging.makeLogRecord({"msg": line}))
            assert self._file.stream is not None
            os.fsync(self._file.stream.fileno())
        except OSError as error:
            self.close()  # the next record opens it again
            raise AuditError(self.path, error) from error

    def close(self) -> None:
        """Close the file."""
        with suppress(OSError):  # a full disk: the record was refused already
            self._file.close()


def _bounded(record: AuditRecord) -> AuditRecord:
    return msgspec.structs.replace(
        record,
        client=cut(record.client, NAME_MAX),
        tool=cut(record.tool, NAME_MAX),
        arguments=cut(record.arguments, ARGUMENTS_MAX),
        words=cut(record.words, TEXT_MAX),
    )
