"""Reading recordings, also recordings without an end because their recorder was killed."""

import os
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from io import BufferedReader
from pathlib import Path
from typing import IO, Any, NamedTuple, cast

import msgspec
import zstandard
from mcap.exceptions import EndOfFile, McapError
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, DataEnd, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from robrain.protocol.clock import to_seconds
from robrain.protocol.model.tasks.old_form import upgraded_json
from robrain.protocol.table.topic import Topic
from robrain.protocol.table.topics import topic_of
from robrain.recording.errors import RecordingError
from robrain.recording.foxglove.visual_topics import is_visual
from robrain.recording.provenance import (
    FORK_METADATA,
    MANIFESTS_METADATA,
    RUN_METADATA,
    SUMMARY_METADATA,
    VERSIONS_METADATA,
    Provenance,
)

DAMAGE = (McapError, zstandard.ZstdError, struct.error, ValueError, KeyError)
"""Exceptions that mcap raises over damaged bytes; a wrong checksum is a ValueError."""

"""In the keys of messages that hold tasks."""

PROGRESS_RECORDS = 1000
"""Number of records between two progress reports."""


class RecordedMessage(NamedTuple):
    """One message out of a recording."""

    topic_key: str
    """The key it had on the wire, its team included."""
    log_time_ns: int
    """The run's clock when it was recorded."""
    payload: bytes
    encoding: str
    """Encoding of the channel, `json` for our own messages."""
    publish_time_ns: int = 0
    """The sender's stamp, or the time of recording where it gave none."""
    sequence: int = 0
    """The sender's number of the message, modulo 2**32."""


@lru_cache(maxsize=4096)
def topic_named_by(key: str) -> Topic[Any] | None:
    """The topic of a key; None for a key that is not of the wire."""
    found = topic_of(key)
    return None if found is None else found[0]


def recorded_message(channel: Channel, message: Message) -> RecordedMessage:
    """A message of a file; tasks and reasons of older recordings get today's form."""
    payload = upgraded_json(message.data) if channel.message_encoding == "json" else message.data
    return RecordedMessage(
        channel.topic, message.log_time, payload, channel.message_encoding, message.publish_time, message.sequence
    )


class RecordingInfo(msgspec.Struct, frozen=True, kw_only=True):
    """Size, duration and counts of a recording."""

    path: Path
    size_bytes: int
    messages: int
    """Messages of the wire; derived channels for viewers are not counted here."""
    start_ns: int
    """The run's clock at the first message; 0 when there is none."""
    duration_s: float
    """From the first message to the last."""
    counts: dict[str, int]
    """Messages of each key."""
    truncated: bool
    """The end is missing; the rest can be read."""
    versions: dict[str, str]
    """Versions of the software that made it; empty when it was not robrain."""
    digest: str
    """Digest of the run; empty when the end is missing."""
    summary: dict[str, str] = {}
    """Summary of its recorder at the end; empty when the end is missing."""


def read_messages(path: Path, on_progress: Callable[[float], None] | None = None) -> Iterator[RecordedMessage]:
    """The messages of a recording in the order in which they were recorded.

    A file that ends in the middle gives its messages up to there.

    Args:
        path: an MCAP file.
        on_progress: called now and then with the share of the file that has been read, 0 to 1.

    Raises:
        RecordingError: there is no such file or it is no recording (at once), or it is damaged (while it is read).
    """
    check_readable(path)
    return _messages(path, on_progress)


def read_provenance(path: Path) -> Provenance:
    """Read the inputs of the recorded run.

    Raises:
        RecordingError: there is no such file, it is no recording, or robrain did not make it.
    """
    metadata, attachments = read_front(path)
    try:
        run, manifests = metadata[RUN_METADATA], metadata.get(MANIFESTS_METADATA)
        return Provenance.from_parts(run, attachments, manifests, metadata.get(FORK_METADATA))
    except (KeyError, ValueError) as error:
        raise RecordingError(
            path, f"{path} has no information about its run: give a recording made by `robrain`"
        ) from error


def recording_info(path: Path) -> RecordingInfo:
    """Duration and contents of a recording; quick, unless its end is missing and it must be read through.

    Raises:
        RecordingError: there is no such file, it is no recording, or it is damaged.
    """
    versions = read_front(path)[0].get(VERSIONS_METADATA, {})
    with _opened(path) as stream:
        size_bytes = stream.seek(0, os.SEEK_END)
        truncated = is_truncated(path)
        if not truncated:
            stream.seek(0)
            reader = make_reader(stream)
            summary = reader.get_summary()
            if summary is not None and summary.statistics is not None:
                run = {metadata.name: metadata.metadata for metadata in reader.iter_metadata()}
                return _info_of_summary(path, size_bytes, summary, versions, run.get(SUMMARY_METADATA, {}))
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
        messages=_of_the_wire(counts),
        start_ns=start_ns or 0,
        duration_s=to_seconds((end_ns or 0) - (start_ns or 0)),
        counts=dict(counts),
        truncated=truncated,
        versions=versions,
        digest="",
    )


def _of_the_wire(counts: Counter[str]) -> int:
    return sum(count for channel, count in counts.items() if not is_visual(channel))


def _info_of_summary(
    path: Path, size_bytes: int, summary: Summary, versions: dict[str, str], message_text: dict[str, str]
) -> RecordingInfo:
    statistics = summary.statistics
    assert statistics is not None
    counts: Counter[str] = Counter()
    for channel_id, count in sorted(statistics.channel_message_counts.items()):
        counts[summary.channels[channel_id].topic] += count
    return RecordingInfo(
        path=path,
        size_bytes=size_bytes,
        messages=_of_the_wire(counts),
        start_ns=statistics.message_start_time,
        duration_s=to_seconds(statistics.message_end_time - statistics.message_start_time),
        counts=dict(counts),
        truncated=False,
        versions=versions,
        digest=message_text.get("digest", ""),
        summary=message_text,
    )


def _messages(path: Path, on_progress: Callable[[float], None] | None = None) -> Iterator[RecordedMessage]:
    channels: dict[int, Channel] = {}
    with _opened(path) as stream:
        size_bytes = os.fstat(stream.fileno()).st_size
        for number, record in enumerate(_records(stream)):
            if on_progress is not None and number % PROGRESS_RECORDS == 0:
                on_progress(stream.tell() / size_bytes)
            if isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                yield recorded_message(channels[record.channel_id], record)
    if on_progress is not None:
        on_progress(1.0)


def read_front(path: Path) -> tuple[dict[str, dict[str, str]], dict[str, bytes]]:
    """Metadata and attachments by name, as far as they stand before the first messages."""
    check_readable(path)
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
    reader = StreamReader(whole_reads(stream), emit_chunks=emit_chunks, validate_crcs=True)
    try:
        yield from reader.records
    except EndOfFile:
        return


def whole_reads(stream: BufferedReader) -> IO[bytes]:
    """The stream as mcap should see it: a record that was cut short is none."""
    return cast(IO[bytes], _WholeReads(stream))


class _WholeReads:
    """Reads all requested bytes or none: mcap would read a truncated record as a whole one."""

    def __init__(self, stream: BufferedReader) -> None:
        self._stream = stream

    def read(self, size: int) -> bytes:
        data = self._stream.read(size)
        return data if len(data) == size else b""


@contextmanager
def _opened(path: Path) -> Iterator[BufferedReader]:
    """The file; its errors become RecordingError."""
    with describing_damage(path), path.open("rb") as stream:
        yield stream


@contextmanager
def describing_damage(path: Path) -> Iterator[None]:
    """Turns errors of the file or its bytes, while the block reads it, into RecordingError."""
    try:
        yield
    except FileNotFoundError as error:
        raise RecordingError(path, f"there is no file {path}: give the path of a recording") from error
    except IsADirectoryError as error:
        raise RecordingError(path, f"{path} is a folder: give the path of a recording in it") from error
    except OSError as error:
        raise RecordingError(
            path, f"cannot read {path}: {error.strerror or error}; check the path and its permissions"
        ) from error
    except DAMAGE as error:
        what = f"{path} is damaged ({str(error) or type(error).__name__})"
        raise RecordingError(path, f"{what}: {_rescue(path)}") from error


def _rescue(path: Path) -> str:
    """Share of a damaged recording that `recover` saves, in words."""
    channels: set[int] = set()
    saved, total = 0, ""
    with path.open("rb") as stream:
        try:
            summary = make_reader(stream).get_summary()
        except (EndOfFile, *DAMAGE):
            summary = None
        if summary is not None:
            channels |= summary.channels.keys()
            total = f" of {summary.statistics.message_count}" if summary.statistics is not None else ""
        stream.seek(0)
        try:
            for record in StreamReader(whole_reads(stream), emit_chunks=True).records:
                parts = _whole(record) if isinstance(record, Chunk) else [record]
                channels |= {part.id for part in parts if isinstance(part, Channel)}
                saved += sum(isinstance(part, Message) and part.channel_id in channels for part in parts)
        except (EndOfFile, *DAMAGE):
            pass  # the rest cannot be read
    return f"`robrain recover` saves {saved}{total} messages" if saved else "take another copy of it"


def _whole(chunk: Chunk) -> list[McapRecord]:
    """The records of a chunk; none if it is damaged."""
    try:
        return breakup_chunk(chunk, validate_crc=True)
    except DAMAGE:
        return []


def is_truncated(path: Path) -> bool:
    """Whether the end of a recording is missing (RecordingError if the file cannot be read)."""
    with _opened(path) as stream:
        size_bytes = stream.seek(0, os.SEEK_END)
        stream.seek(max(size_bytes - len(MCAP0_MAGIC), 0))
        return size_bytes < 2 * len(MCAP0_MAGIC) or stream.read() != MCAP0_MAGIC


def check_readable(path: Path) -> None:
    """Raise RecordingError unless there is a file that begins as a recording does."""
    with _opened(path) as stream:
        start = stream.read(len(MCAP0_MAGIC))
    if not start:
        raise RecordingError(path, f"{path} is empty: its recorder was stopped before it wrote anything, record again")
    if start != MCAP0_MAGIC:
        raise RecordingError(path, f"{path} is not an MCAP file: give a recording made by `robrain`")
