"""The digest of a run: equal for two runs that said the same in the same order."""

import hashlib
import struct
from collections.abc import Iterable, Sequence
from itertools import islice

AT_ONCE = 64
"""Messages put together for the digest: few enough that what is put together stays in the processor's cache."""

_STAMP_AND_PAYLOAD_LENGTH = struct.Struct("<QQ")

DigestedMessage = tuple[object, str, bytes, int, int]
"""Topic, key, payload, the sender's stamp in nanoseconds, and its number; topic and number do not count."""


class RunDigest:
    """SHA-256 over key, stamp and payload of every message, in order."""

    def __init__(self) -> None:
        self._digest = hashlib.sha256()
        self._key_prefixes: dict[str, bytes] = {}

    def add(self, told: Sequence[DigestedMessage]) -> None:
        """Take messages in."""
        for start in range(0, len(told), AT_ONCE):
            self._digest.update(self._digested(islice(told, start, start + AT_ONCE)))

    def hexdigest(self) -> str:
        """The digest so far."""
        return self._digest.hexdigest()

    def _digested(self, told: Iterable[DigestedMessage]) -> bytes:
        prefixes, pack = self._key_prefixes, _STAMP_AND_PAYLOAD_LENGTH.pack
        parts: list[bytes] = []
        for _, key, payload, stamp_ns, _ in told:
            parts += (prefixes.get(key) or self._add_key(key), pack(stamp_ns, len(payload)), payload)
        return b"".join(parts)

    def _add_key(self, key: str) -> bytes:
        encoded = key.encode()
        prefix = self._key_prefixes[key] = len(encoded).to_bytes(8, "little") + encoded
        return prefix
