"""What the camera offers."""

from typing import Protocol

import msgspec


class Picture(msgspec.Struct, frozen=True, kw_only=True):
    """What a camera saw. It does not know where it was: whoever asked for it does."""

    png: bytes
    width: int
    height: int
    """Pixels."""
    stamp_ns: int
    """When it was taken, by the run's clock."""


class CameraInterface(Protocol):
    """Pictures when they are wanted."""

    def snapshot(self) -> Picture:
        """Take a picture.

        Raises:
            CallError: the camera gives none; the text says why.

        """
