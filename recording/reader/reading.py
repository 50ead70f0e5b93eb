"""Reading recordings, also recordings without an end because their recorder was killed."""

import os
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import IO, cast

import msgspec
import zstandard
from mcap.exceptions import EndOfFile, McapError
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, DataEnd, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from robrain.protocol.clock import to_seconds
from robrain.protocol.model.tasks.old_form import upgraded_json
from robrain.recording.errors import RecordingError
from robrain.recording.foxglove.visual_topics import is_visual
from robrain.recording.provenance import SUMMARY_METADATA, VERSIONS_METADATA, Provenance
from robrain.recording.reader.recorded_message import RecordedMessage

DAMAGE = (McapError, zstandard.ZstdError, struct.error, ValueError, KeyError)
"""Exceptions that mcap raises over damaged bytes; a wrong checksum is a ValueError."""

PROGRESS_RECORDS = 1000
"""Number of records between two progress reports."""


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
        return Provenance.from_records(metadata, attachments)
    except (KeyError, ValueError) as error:
        raise RecordingError(
            path, f"{path} has no information about its run: use a recording made by `robrain`"
        ) from error


def recording_info(path: Path) -> RecordingInfo:
    """Duration and contents of a recording; quick, unless its end is missing and it must be read through.

    Raises:
        RecordingError: there is no such file, it is no recording, or it is damaged.
    """
    versions = read_front(path)[0].get(VERSIONS_METADATA, {})
    truncated = is_truncated(path)
    counts: Counter[str] = Counter()
    start_ns = end_ns = 0
    recorder: dict[str, str] = {}
    metadata: dict[str, dict[str, str]] = {}
    summary = None
    if not truncated:
        with _opened(path) as stream:
            reader = make_reader(stream)
            summary = reader.get_summary()
            metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    if summary is not None and summary.statistics is not None:
        statistics = summary.statistics
        for channel_id, count in sorted(statistics.channel_message_counts.items()):
            counts[summary.channels[channel_id].topic] += count
        start_ns, end_ns = statistics.message_start_time, statistics.message_end_time
        recorder = metadata.get(SUMMARY_METADATA, {})
    else:
        for message in _messages(path):
            # The wall's clock may have been set back in between.
            start_ns = min(start_ns, message.log_time_ns) if counts else message.log_time_ns
            end_ns = max(end_ns, message.log_time_ns)
            counts[message.topic_key] += 1
    return RecordingInfo(
        path=path,
        size_bytes=path.stat().st_size,
        messages=sum(count for channel, count in counts.items() if not is_visual(channel)),
        start_ns=start_ns,
        duration_s=to_seconds(end_ns - start_ns),
        counts=dict(counts),
        truncated=truncated,
        versions=versions,
        digest=recorder.get("digest", ""),
        summary=recorder,
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
        raise RecordingError(path, f"{path} is not an MCAP file: use a recording made by `robrain`")
