"""The recorder: writes all that a team says on its recorded topics, and keeps a digest of it."""

import hashlib
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec

from robrain.coordinator.recording.errors import RecordingError
from robrain.coordinator.recording.provenance import Provenance
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.topic import JSON, Kind
from robrain.protocol.wire.topics import ARENA_OUTSIDE, TOPICS

if TYPE_CHECKING:
    from robrain.coordinator.recording.recording_file import RecordingFile

INBOX_CAPACITY = 65536
SEQUENCE_MASK = 0xFFFF_FFFF
"""MCAP's sequence numbers have 32 bits."""

_STAMP_AND_PAYLOAD_LENGTH = struct.Struct("<QQ")


class RecordingSummary(msgspec.Struct, frozen=True):
    """What a recorder did."""

    messages: int
    """Messages heard, all of them in the digest."""
    bytes: int
    """Size of the file; 0 without one."""
    digest: str
    outside: int
    """Messages that reached a lockstep run from another process: it cannot be repeated if there are any."""
    dropped: int
    """Messages that came faster than they were written, and are in neither file nor digest."""
    path: Path | None
    lost: int = 0
    """Messages in the digest that the disk did not take."""


class _Stamp(msgspec.Struct):
    stamp_ns: Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)] = 0
    seq: Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)] = 0


_UNSTAMPED = _Stamp()


class Recorder:
    """Hears every recorded topic of a team, in order of arrival, and writes each message as it was on the wire.

    Two runs that said the same, in the same order, have the same `digest`; with a file or without.

    Args:
        endpoint: where to listen; its owner closes it, after the recorder.
        path: an MCAP file to write, or None for the digest alone.
        provenance: what the run was started with.

    Raises:
        RecordingError: the file cannot be written; nothing is declared then, and nothing left on the disk.
    """

    def __init__(self, endpoint: Endpoint, path: Path | None, provenance: Provenance) -> None:
        self._clock = endpoint.clock
        self._file = _open_file(path, provenance, self._clock.now_ns()) if path is not None else None
        self._inbox = Inbox(capacity=INBOX_CAPACITY, every=True)
        self._digest = hashlib.sha256()
        self._key_prefixes: dict[str, bytes] = {}
        self._stamps = msgspec.json.Decoder(_Stamp)
        self._messages = 0
        self._outside_queries = 0
        self._summary: RecordingSummary | None = None
        for topic in TOPICS:
            if topic.recorded and topic.kind is Kind.PUT:
                endpoint.subscribe(self._inbox, topic)

    @property
    def messages(self) -> int:
        """Messages recorded so far."""
        return self._messages

    @property
    def outside(self) -> int:
        """Messages and queries of other processes that had a say in a lockstep run."""
        return self._inbox.outside + self._outside_queries

    @property
    def digest(self) -> str:
        """SHA-256 over key, stamp and payload of every message in order, as hex.

        When other processes had a say in a lockstep run, `+outside:N` follows: N messages came from them.
        """
        outside = self.outside
        return self._digest.hexdigest() + (f"+outside:{outside}" if outside else "")

    def step(self) -> None:
        """Record what has arrived since the last step. After `close` it does nothing."""
        if self._summary is not None:
            return
        now_ns = self._clock.now_ns()
        file = self._file
        digested: list[bytes] = []
        for topic, key, payload in self._inbox.drain_raw():
            stamp = self._stamp(payload) if topic.encoding == JSON else _UNSTAMPED
            stamp_ns = stamp.stamp_ns or now_ns
            prefix = self._key_prefixes.get(key) or self._add_key(key)
            digested += (prefix, _STAMP_AND_PAYLOAD_LENGTH.pack(stamp_ns, len(payload)), payload)
            self._messages += 1
            self._outside_queries += topic is ARENA_OUTSIDE
            if file is not None:
                file.write(
                    topic,
                    key,
                    payload,
                    log_time_ns=now_ns,
                    publish_time_ns=stamp_ns,
                    sequence=stamp.seq & SEQUENCE_MASK,
                )
        self._digest.update(b"".join(digested))
        if file is not None:
            file.flush_if_due(now_ns)

    def close(self) -> RecordingSummary:
        """Record what is left, finish the file and return what was done; calling it again returns the same."""
        if self._summary is None:
            self.step()
            if self._file is not None:
                self._file.close(
                    {
                        "messages": str(self._messages),
                        "digest": self.digest,
                        "outside": str(self.outside),
                        "dropped": str(self._inbox.dropped),
                        "lost": str(self._file.lost),
                    }
                )
            self._summary = RecordingSummary(
                messages=self._messages,
                bytes=self._file.size_bytes if self._file is not None else 0,
                digest=self.digest,
                outside=self.outside,
                dropped=self._inbox.dropped,
                path=self._file.path if self._file is not None else None,
                lost=self._file.lost if self._file is not None else 0,
            )
        return self._summary

    def _stamp(self, payload: bytes) -> _Stamp:
        try:
            return self._stamps.decode(payload)
        except (msgspec.DecodeError, UnicodeDecodeError):
            # What does not decode was on the wire all the same.
            return _UNSTAMPED

    def _add_key(self, key: str) -> bytes:
        encoded = key.encode()
        prefix = self._key_prefixes[key] = len(encoded).to_bytes(8, "little") + encoded
        return prefix


def _open_file(path: Path, provenance: Provenance, now_ns: int) -> "RecordingFile":
    try:
        # A digest alone does not need mcap, which comes with an extra.
        from robrain.coordinator.recording.recording_file import RecordingFile
    except ModuleNotFoundError as error:
        raise RecordingError(
            path, f"cannot record to {path}: {error.name} is not installed; pip install 'robrain[team]'"
        ) from error
    return RecordingFile(path, provenance, now_ns)
