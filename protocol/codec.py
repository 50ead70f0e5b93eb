"""Reading and writing one type of payload: the one place where input becomes a value."""

from collections.abc import Callable
from typing import Any, Generic, TypeVar, get_args

import msgspec

T = TypeVar("T")

BAD_PAYLOAD = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)
"""Errors of msgspec for a payload that does not decode; RecursionError if it is nested too deep."""
NONE = type(None)


class BadPayload(Exception):
    """A payload that is too large, does not decode, or holds a value that is out of range."""

    def __init__(self, why: str, *, is_too_large: bool = False) -> None:
        super().__init__(why)
        self.is_too_large = is_too_large


class Codec(Generic[T]):
    """Reads and writes payloads of one type.

    Args:
        kind: the type; `bytes` leaves payloads as they are, `NoneType` reads nothing from them.
        max_bytes: size of the largest payload that is read.
        what: name for error texts.

    """

    def __init__(self, kind: type[T], max_bytes: int, what: str) -> None:
        self.kind = kind
        self.max_bytes = max_bytes
        self._what = what
        self.decode: Callable[[bytes], T] = _plain(kind) if kind in (bytes, NONE) else msgspec.json.Decoder(kind).decode
        """Reads a payload of allowed size that is not empty; raises one of `BAD_PAYLOAD`."""

    @property
    def empty(self) -> bytes:
        """Meaning of an empty payload."""
        return b"" if self.kind is bytes else b"{}"

    def read(self, payload: bytes) -> T:
        """Decode a payload; an empty one counts as `{}`.

        Raises:
            BadPayload: it is too large, does not decode, or holds a value that is out of range.

        """
        if len(payload) > self.max_bytes:
            raise BadPayload(self.too_large(len(payload)), is_too_large=True)
        try:
            return self.decode(payload or self.empty)
        except BAD_PAYLOAD as error:
            raise BadPayload(self.not_one(error)) from error

    def read_if_valid(self, payload: bytes) -> T | None:
        """The decoded payload; None where `read` raises."""
        try:
            return self.read(payload)
        except BadPayload:
            return None

    def not_one(self, error: Exception) -> str:
        """The error text for a payload that does not decode."""
        return f"expected {_name(self.kind)}: {error}"

    def too_large(self, size: int) -> str:
        """The error text for a payload of `size` bytes."""
        return f"expected at most {self.max_bytes} bytes of {self._what}, got {size}"

    def write(self, value: object) -> bytes:
        """Encode a value of the type; bytes are taken for JSON already."""
        return value if isinstance(value, bytes) else msgspec.json.encode(value)


def _plain(kind: Any) -> Callable[[bytes], Any]:
    """Reads bytes as they are, or nothing."""
    return bytes if kind is bytes else lambda _payload: None


def _name(kind: Any) -> str:
    """The type's name with an article, for error texts."""
    inner = get_args(kind)
    if inner:
        return " or ".join(_name(one) if one is not NONE else "null" for one in inner)
    name: str = getattr(kind, "__name__", str(kind))
    return f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"
