"""Errors of journals.

RobrainError
└── JournalError              unusable; carries `.path`
    ├── JournalLocked         written by another coordinator
    ├── BadBackup             fails its check
    └── JournalUnwritable     the disk is full or gone
"""

from pathlib import Path

from robrain.protocol.errors import RobrainError


class JournalError(RobrainError):
    """A journal cannot be used; the text names the file and the remedy. `path` is None in memory."""

    def __init__(self, path: Path | None, message: str) -> None:
        super().__init__(f"{path if path is not None else 'the journal in memory'}: {message}")
        self.path = path


class JournalLocked(JournalError):
    """Another coordinator writes this journal."""


class JournalUnwritable(JournalError):
    """A change could not be committed; nothing of it is in the journal, and it may be tried again."""


class BadBackup(JournalError):
    """A backup does not pass the check, and is not used."""
