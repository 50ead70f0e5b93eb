"""Errors of journals.

RobrainError
└── JournalError              a journal cannot be used; carries `.path`
    ├── JournalLocked         another coordinator writes it
    ├── BadBackup             a backup does not pass the check
    └── JournalUnwritable     a change could not be committed: the disk is full, or gone
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
