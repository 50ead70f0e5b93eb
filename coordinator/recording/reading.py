"""Reading recordings, also those whose end is missing because their recorder was killed."""

import os
import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import IO, NamedTuple, cast

import msgspec
import zstandard
from mcap.exceptions import EndOfFile, McapError
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, DataEnd, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from robrain.coordinator.recording.errors import RecordingError
from robrain.coordinator.recording.provenance import RUN_METADATA, SUMMARY_METADATA, VERSIONS_METADATA, Provenance
from robrain.protocol.wire.clock import to_seconds

_DAMAGE = (McapError, zstandard.ZstdError, struct.error, ValueError, KeyError)
"""What mcap raises over bytes that are not what they should be; a wrong checksum is a ValueError."""


class RecordedMessage(NamedTuple):
    """One message out of a recording."""

    topic_key: str
    """The key it had on the wire, its team included."""
    log_time_ns: int
    """The run's clock when it was recorded."""
    payload: bytes
    encoding: str
    """Encoding of the channel, `json` for our own messages."""


class RecordingInfo(msgspec.Struct, frozen=True, kw_only=True):
    """What a recording holds."""

    path: Path
    size_bytes: int
    messages: int
    start_ns: int
    """The run's clock at the first message; 0 when there is none."""
    duration_s: float
    """From the first message to the last."""
    counts: dict[str, int]
    """Messages of each key."""
    truncated: bool
    """The end is missing; what is there can be read."""
    versions: dict[str, str]
    """Versions of the software that made it; empty when it was not robrain."""
    digest: str
    """Digest of the run; empty when the end is missing."""


def read_messages(path: Path) -> Iterator[RecordedMessage]:
    """The messages of a recording in the order in which they were recorded.

    A file that ends in the middle gives what is there.

    Raises:
        RecordingError: there is no such file or it is no recording (at once), or it is damaged (on the way).
    """
    _check_readable(path)
    return _messages(path)


def read_provenance(path: Path) -> Provenance:
    """What the recorded run was started with.

    Raises:
        RecordingError: there is no such file, it is no recording, or robrain did not make it.
    """
    metadata, attachments = _read_front(path)
    try:
        return Provenance.from_parts(metadata[RUN_METADATA], attachments)
    except (KeyError, ValueError) as error:
        raise RecordingError(
            path, f"{path} does not say which run it is of: give a recording made by `robrain`"
        ) from error


def recording_info(path: Path) -> RecordingInfo:
    """How long a recording is and what is in it; quick, unless its end is missing and it must be read through.

    Raises:
        RecordingError: there is no such file, it is no recording, or it is damaged.
    """
    versions = _read_front(path)[0].get(VERSIONS_METADATA, {})
    with _opened(path) as stream:
        size_bytes = stream.seek(-len(MCAP0_MAGIC), os.SEEK_END) + len(MCAP0_MAGIC)
        truncated = size_bytes < 2 * len(MCAP0_MAGIC) or stream.read() != MCAP0_MAGIC
        if not truncated:
            stream.seek(0)
            reader = make_reader(stream)
            summary = reader.get_summary()
            if summary is not None and summary.statistics is not None:
                run = {metadata.name: metadata.metadata for metadata in reader.iter_metadata()}
                digest = run.get(SUMMARY_METADATA, {}).get("digest", "")
                return _info_of_summary(path, size_bytes, summary, versions, digest)
    counts: Counter[str] = Counter()
    start_ns = end_ns = None
    for message in _messages(path):
        counts[message.topic_key] += 1
        # The wall's clock may have been set back in between.
        start_ns = message.log_time_ns if start_ns is None else min(start_ns, message.log_time_ns)
        end_ns = message.log_time_ns if end_ns is None else max(end_ns, message.log_time_ns)
    return RecordingInfo(
        path=path,
        size_bytes=size_bytes,
        messages=counts.total(),
        start_ns=start_ns or 0,
        duration_s=to_seconds((end_ns or 0) - (start_ns or 0)),
        counts=dict(counts),
        truncated=truncated,
        versions=versions,
        digest="",
    )


def _info_of_summary(
    path: Path, size_bytes: int, summary: Summary, versions: dict[str, str], digest: str
) -> RecordingInfo:
    statistics = summary.statistics
    assert statistics is not None
    counts: Counter[str] = Counter()
    for channel_id, count in sorted(statistics.channel_message_counts.items()):
        counts[summary.channels[channel_id].topic] += count
    return RecordingInfo(
        path=path,
        size_bytes=size_bytes,
        messages=statistics.message_count,
        start_ns=statistics.message_start_time,
        duration_s=to_seconds(statistics.message_end_time - statistics.message_start_time),
        counts=dict(counts),
        truncated=False,
        versions=versions,
        digest=digest,
    )


def _messages(path: Path) -> Iterator[RecordedMessage]:
    channels: dict[int, Channel] = {}
    with _opened(path) as stream:
        for record in _records(stream):
            if isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                yield RecordedMessage(channel.topic, record.log_time, record.data, channel.message_encoding)


def _read_front(path: Path) -> tuple[dict[str, dict[str, str]], dict[str, bytes]]:
    """Metadata and attachments by name, as far as they stand before the first messages."""
    _check_readable(path)
    metadata: dict[str, dict[str, str]] = {}
    attachments: dict[str, bytes] = {}
    with _opened(path) as stream:
        for record in _records(stream, emit_chunks=True):
            if isinstance(record, Metadata):
                metadata[record.name] = record.metadata
            elif isinstance(record, Attachment):
                attachments[record.name] = record.data
            elif isinstance(record, (Chunk, Message, DataEnd)):
                break
    return metadata, attachments


def _records(stream: BufferedReader, *, emit_chunks: bool = False) -> Iterator[McapRecord]:
    """Records up to the end of the file, or to where it breaks off."""
    reader = StreamReader(cast(IO[bytes], _WholeReads(stream)), emit_chunks=emit_chunks, validate_crcs=True)
    try:
        yield from reader.records
    except EndOfFile:
        return


class _WholeReads:
    """Reads all that is asked for or nothing: mcap takes a record that was cut short for a whole one."""

    def __init__(self, stream: BufferedReader) -> None:
        self._stream = stream

    def read(self, size: int) -> bytes:
        data = self._stream.read(size)
        return data if len(data) == size else b""


@contextmanager
def _opened(path: Path) -> Iterator[BufferedReader]:
    """The file, with what is wrong with it or its bytes turned into RecordingError."""
    try:
        with path.open("rb") as stream:
            yield stream
    except FileNotFoundError as error:
        raise RecordingError(path, f"there is no file {path}: give the path of a recording") from error
    except IsADirectoryError as error:
        raise RecordingError(path, f"{path} is a folder: give the path of a recording in it") from error
    except OSError as error:
        raise RecordingError(
            path, f"cannot read {path}: {error.strerror or error}; check the path and who may read it"
        ) from error
    except _DAMAGE as error:
        raise RecordingError(
            path, f"{path} is damaged ({str(error) or type(error).__name__}): take another copy of it"
        ) from error


def _check_readable(path: Path) -> None:
    with _opened(path) as stream:
        start = stream.read(len(MCAP0_MAGIC))
    if not start:
        raise RecordingError(path, f"{path} is empty: its recorder was stopped before it wrote anything, record again")
    if start != MCAP0_MAGIC:
        raise RecordingError(path, f"{path} is not an MCAP file: give a recording made by `robrain`")
