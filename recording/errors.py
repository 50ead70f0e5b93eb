"""Errors of recordings.

RobrainError
└── RecordingError            a recording cannot be written, read or replayed; carries `.path`
ValueError
└── MapError                  a map cannot be used
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from robrain.protocol.errors import RobrainError


class RecordingError(RobrainError):
    """A recording cannot be used; the text names the file and the remedy."""

    def __init__(self, path: Path, message: str) -> None:
        super().__init__(message)
        self.path = path


class MapError(ValueError):
    """A map, a drawing or a floor plan that cannot be used, reported in one sentence that names file and key."""


@contextmanager
def writing(path: Path, hint: str = "") -> Iterator[None]:
    """Turns errors of a file, while the block writes it, into RecordingError; `hint` ends its text."""
    try:
        yield
    except FileExistsError as error:
        raise _exists(path) from error
    except OSError as error:
        raise RecordingError(path, f"cannot write {path}: {error.strerror or error}{hint}") from error


def check_absent(path: Path) -> None:
    """Raise RecordingError if there is a file of this name already: nothing is overwritten."""
    if path.exists():
        raise _exists(path)


def _exists(path: Path) -> RecordingError:
    return RecordingError(path, f"{path} exists already: give another name or move it away")
