"""What can go wrong with recordings.

RobrainError
└── RecordingError            a recording cannot be written, read or replayed; carries `.path`
"""

from pathlib import Path

from robrain.protocol.wire.errors import RobrainError


class RecordingError(RobrainError):
    """A recording cannot be used; the text names the file and says what to do."""

    def __init__(self, path: Path, message: str) -> None:
        super().__init__(message)
        self.path = path
