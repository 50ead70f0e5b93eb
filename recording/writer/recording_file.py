"""One MCAP file, being written.

The data that repeats the run is at the front, and messages go to the disk at least every half second. If its writer is
killed, the file still has its description and all but the last moment.
"""

import contextlib
import logging
import sys
from collections import Counter
from collections.abc import Iterable, Mapping
from functools import cache
from io import FileIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, cast

import msgspec
from mcap.writer import LIBRARY_IDENTIFIER, Writer

from robrain.protocol.clock import to_ns
from robrain.protocol.schema.struct_schema import bare, schema_of
from robrain.protocol.topic import JSON, Topic
from robrain.recording.errors import RecordingError
from robrain.recording.foxglove.plain_schema import plain_schema
from robrain.recording.provenance import (
    HOST_METADATA,
    PART_METADATA,
    SUMMARY_METADATA,
    VERSIONS_METADATA,
    Provenance,
    host_description,
    software_versions,
)

if TYPE_CHECKING:
    from robrain.recording.foxglove.channels import VisualMessage

logger = logging.getLogger(__name__)

SUFFIX = ".mcap"
FLUSH_PERIOD_NS = to_ns(0.5)
CHUNK_BYTES = 1024 * 1024
EXACT_SCHEMA = "json_schema"
"""Key in a channel's metadata: the JSON Schema that each of its messages is valid against. The schema beside it is its
plain form for Foxglove, which has no alternatives such as null.
"""
CHANNELS_MAX = 65535
"""MCAP numbers channels with 16 bits, from 1."""

StampedMessage = tuple[Topic[Any], str, bytes, int, int]
"""A message of the wire: topic, key, payload, its sender's stamp in nanoseconds, and its number."""


class RecordingFile:
    """Writes messages to an MCAP file.

    A disk that fails during the run is reported once; the run continues without the file.

    Args:
        path: file to write; an older recording of that name is replaced.
        provenance: goes to the front of the file.
        now_ns: the run's clock at opening.
        part: description of a file that is one of several; None if it is not.

    Raises:
        RecordingError: the file cannot be written; then no file remains.
    """

    def __init__(self, path: Path, provenance: Provenance, now_ns: int, part: Mapping[str, str] | None = None) -> None:
        self.path = path
        self.opened_ns = now_ns
        self.messages = 0
        """Messages of the wire that were handed over, written or not."""
        self.lost_by_topic: Counter[str] = Counter()
        """Messages of the wire that could not be written, by the topic's name."""
        self.failure = ""
        """Reason for its failure; empty if it has not failed."""
        self.has_messages = False
        """Whether any message is on the disk."""
        self._held: list[str] = []
        """Topic's name of each message of the wire that waits to be written."""
        self._held_bytes = 0
        self._flushed_ns = now_ns
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        try:
            check_writable(path)
            self._stream = _Stream(open_file(path))
        except OSError as error:
            raise _cannot_write(path, error) from error
        # A chunk ends with `flush` and nowhere else.
        self._writer = Writer(cast(IO[bytes], self._stream), chunk_size=sys.maxsize)
        try:
            self._write_front(provenance, part)
        except OSError as error:
            self._stream.close()
            path.unlink(missing_ok=True)
            raise _cannot_write(path, error) from error
        self._whole_bytes = self._stream.size_bytes

    @property
    def size_bytes(self) -> int:
        """Bytes in the file so far."""
        return self._stream.size_bytes

    @property
    def held_bytes(self) -> int:
        """Bytes of payloads that wait to be written."""
        return self._held_bytes

    def write(self, messages: Iterable[StampedMessage], log_time_ns: int) -> None:
        """Add messages; counted in `lost_by_topic` when the file has failed."""
        add_message, hold, channels = self._writer.add_message, self._held.append, self._channels
        for topic, key, payload, publish_time_ns, sequence in messages:
            self.messages += 1
            channel_id = 0 if self.failure else channels.get(key) or self._add_topic(topic, key)
            if not channel_id:
                self.lost_by_topic[topic.name] += 1
                continue
            add_message(channel_id, log_time_ns, payload, publish_time_ns, sequence)
            hold(topic.name)
            self._held_bytes += len(payload)
            if self._held_bytes >= CHUNK_BYTES:
                self._write_out()

    def write_beside(self, topic: Topic[Any], key: str, payload: bytes, now_ns: int) -> None:
        """Add a message that was not on the wire; it is never counted as lost."""
        channel_id = 0 if self.failure else self._channels.get(key) or self._add_topic(topic, key)
        if channel_id:
            self.messages += 1
            self._add(channel_id, now_ns, payload, now_ns)

    def write_visual(self, visual: "VisualMessage", log_time_ns: int) -> None:
        """Add a derived message; if it is lost, it can be derived again."""
        channel_id = 0 if self.failure else self._channels.get(visual.channel)
        if channel_id is None:
            channel_id = self._add_channel(visual.channel, visual.encoding, visual.schema())
        if channel_id:
            self._add(channel_id, log_time_ns, visual.data(), visual.stamp_ns)

    def flush_if_due(self, now_ns: int) -> None:
        """Give buffered messages to the operating system when half a second of the run's clock has passed."""
        if now_ns - self._flushed_ns >= FLUSH_PERIOD_NS:
            self._flushed_ns = now_ns
            self._write_out()

    def close(self, summary: Mapping[str, str]) -> None:
        """Write buffered messages, the summary of the run and the file's index, and close it."""
        self._write_out()
        if self.failure:
            return
        try:
            self._writer.add_metadata(SUMMARY_METADATA, dict(summary))
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._stream.close()
        except OSError as error:
            self._fail(error)

    def _add(self, channel_id: int, log_time_ns: int, payload: bytes, publish_time_ns: int) -> None:
        self._writer.add_message(channel_id, log_time_ns, payload, publish_time_ns)
        self._held_bytes += len(payload)
        if self._held_bytes >= CHUNK_BYTES:
            self._write_out()

    def _write_out(self) -> None:
        if self.failure or not self._held_bytes:
            return
        try:
            self._writer.flush()  # type: ignore[no-untyped-call]
        except OSError as error:
            self._fail(error)
            return
        self._held.clear()
        self._held_bytes = 0
        self._whole_bytes = self._stream.size_bytes
        self.has_messages = True

    def _fail(self, error: OSError) -> None:
        logger.error(
            "recording to %s stopped: %s; what was written until now can be read, the run goes on, unrecorded until "
            "there is room again",
            self.path,
            error.strerror or error,
        )
        self.failure = error.strerror or str(error) or type(error).__name__
        self.lost_by_topic.update(self._held)
        self._held.clear()
        with contextlib.suppress(OSError):  # the disk has failed already, which was reported above
            self._stream.cut(self._whole_bytes)
        with contextlib.suppress(OSError):
            self._stream.close()

    def _write_front(self, provenance: Provenance, part: Mapping[str, str] | None) -> None:
        writer = self._writer
        writer.start("robrain", LIBRARY_IDENTIFIER)
        records = {**provenance.metadata(), VERSIONS_METADATA: software_versions(), HOST_METADATA: host_description()}
        if part is not None:
            records[PART_METADATA] = dict(part)
        for name, values in records.items():
            writer.add_metadata(name, values)
        for name, media_type, content in provenance.attachments():
            writer.add_attachment(0, 0, name, media_type, content)

    def _add_topic(self, topic: Topic[Any], key: str) -> int:
        encoding = "json" if topic.encoding == JSON else topic.encoding
        if topic.message is None:
            return self._add_channel(key, encoding)
        schema = (f"robrain.{topic.message.__name__}", "jsonschema", object_schema(topic))
        return self._add_channel(key, encoding, schema, {EXACT_SCHEMA: exact_schema(topic)})

    def _add_channel(
        self,
        key: str,
        encoding: str,
        schema: tuple[str, str, bytes] | None = None,
        metadata: Mapping[str, str] | None = None,
    ) -> int:
        """Id of a new channel, or 0 when the file has all it can hold; a schema has name, encoding and text."""
        if len(self._channels) >= CHANNELS_MAX:
            return 0
        if schema is not None and schema[0] not in self._schemas:
            self._schemas[schema[0]] = self._writer.register_schema(*schema)
        schema_id = 0 if schema is None else self._schemas[schema[0]]
        channel_id = self._writer.register_channel(key, encoding, schema_id, dict(metadata or {}))
        self._channels[key] = channel_id
        return channel_id


class _Stream:
    """A file without a buffer: written data are with the operating system, also after a kill -9."""

    def __init__(self, file: FileIO) -> None:
        self._file = file
        self.size_bytes = 0

    def write(self, data: bytes) -> int:
        rest = memoryview(data)
        while rest:
            # A disk that is nearly full accepts a part of it first.
            written = self._file.write(rest)
            self.size_bytes += written
            rest = rest[written:]
        return len(data)

    def tell(self) -> int:
        return self.size_bytes

    def flush(self) -> None:
        self._file.flush()

    def cut(self, size_bytes: int) -> None:
        self._file.truncate(size_bytes)
        self.size_bytes = size_bytes

    def close(self) -> None:
        self._file.close()


def open_file(path: Path) -> FileIO:
    """Open `path` for writing, empty and without a buffer; raises OSError."""
    return FileIO(path, "w")


@cache
def exact_schema(topic: Topic[Any]) -> str:
    """JSON Schema of the messages of a topic, without titles and descriptions."""
    return msgspec.json.encode(bare(schema_of(topic.message))).decode()


@cache
def object_schema(topic: Topic[Any]) -> bytes:
    """JSON Schema of a topic's message in the form that Foxglove and Lichtblick accept."""
    return msgspec.json.encode(plain_schema(topic.json_schema()))


def check_writable(path: Path) -> None:
    """Raise RecordingError if no recording can be written to this path."""
    if path.suffix != SUFFIX:
        raise RecordingError(path, f"cannot record to {path}: give a file name that ends in {SUFFIX}")
    if path.is_dir():
        raise RecordingError(path, f"cannot record to {path}: it is a folder; give the name of a file in it")
    if path.exists() and not path.is_file():
        raise RecordingError(path, f"cannot record to {path}: it is not a regular file; give another name")
    if not path.parent.is_dir():
        raise RecordingError(path, f"cannot record to {path}: there is no folder {path.parent}; create it first")


def _cannot_write(path: Path, error: OSError) -> RecordingError:
    return RecordingError(
        path, f"cannot record to {path}: {error.strerror or error}; free some space there or give another file"
    )
