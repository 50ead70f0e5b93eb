"""Recovery of a file that is damaged or lacks its end, and derived channels for a file without them."""

import contextlib
import os
from collections.abc import Callable
from io import BufferedReader, BufferedWriter
from pathlib import Path

import msgspec
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, DataEnd, Header, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from robrain.recording.errors import RecordingError, writing
from robrain.recording.foxglove.channels import FoxgloveChannels, VisualMessage
from robrain.recording.foxglove.visual_topics import is_visual
from robrain.recording.provenance import RECOVERY_METADATA, VISUAL_METADATA
from robrain.recording.reader.reading import DAMAGE, check_readable, describing_damage, is_truncated, whole_reads
from robrain.recording.reader.recorded_message import topic_named_by

CHUNK_BYTES = 1024 * 1024


class RecordingCopy:
    """A new file, to which the records of another are handed one by one."""

    def __init__(self, target: BufferedWriter, visual: FoxgloveChannels | None, *, truncated: bool) -> None:
        self.truncated = truncated
        """Whether the end of the source is missing."""
        self._writer = Writer(target, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._started = False
        self._schemas: dict[int, Schema] = {}
        self._schema_ids: dict[int, int] = {}
        self._channels: dict[int, Channel] = {}
        self._channel_ids: dict[int, int] = {}
        self.messages = 0
        self.damaged_chunks = 0
        self.undescribed = 0
        self.visual_messages = 0
        self.unread_bytes = 0
        self.ended = False
        self._visual = visual
        self._visual_ids: dict[str, int] = {}
        self._visual_schemas: dict[str, int] = {}
        self._now_ns: int | None = None

    def read_descriptions(self, stream: BufferedReader) -> None:
        """Read the descriptions of channels from the summary of a source that has one."""
        with contextlib.suppress(EndOfFile, *DAMAGE):  # the index is damaged; the records before it may be whole
            summary = make_reader(stream).get_summary()
            if summary is not None:
                self._schemas, self._channels = dict(summary.schemas), dict(summary.channels)
        stream.seek(0)

    def handle(self, record: McapRecord) -> None:
        """The next record of the source; a chunk that is damaged is left out, and counted."""
        if isinstance(record, Header):
            self._start(record.profile, record.library)
        elif isinstance(record, Chunk):
            try:
                parts = breakup_chunk(record, validate_crc=True)
            except DAMAGE:
                self.damaged_chunks += 1
                return
            for part in parts:
                self.handle(part)
        elif isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._channels[record.id] = record
        elif isinstance(record, Message):
            self._handle_message(record)
        elif isinstance(record, Metadata):
            self._start()
            self._writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            self._start()
            self._writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
        elif isinstance(record, DataEnd):
            self.ended = True

    def finish(self) -> None:
        """Write a record of metadata about the copy, the index and the summary."""
        self._start()
        self._draw()
        if self._visual is not None:
            self._writer.add_metadata(VISUAL_METADATA, {"messages": str(self.visual_messages)})
        else:
            losses = {
                "messages": str(self.messages),
                "was_truncated": str(self.truncated).lower(),
                "damaged_chunks": str(self.damaged_chunks),
                "undescribed": str(self.undescribed),
                "unread_bytes": str(self.unread_bytes),
            }
            self._writer.add_metadata(RECOVERY_METADATA, losses)
        self._writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it unannotated

    def _start(self, profile: str = "", library: str | None = None) -> None:
        if not self._started:
            self._started = True
            self._writer.start(profile=profile) if library is None else self._writer.start(profile, library)

    def _handle_message(self, message: Message) -> None:
        channel = self._channels.get(message.channel_id)
        if channel is None:  # it was described in a chunk that is damaged, and there is no summary
            self.undescribed += 1
            return
        if self._visual is not None and is_visual(channel.topic):
            return
        self._start()
        self._watch(channel, message)
        channel_id = self._channel_ids.get(message.channel_id)
        if channel_id is None:
            channel_id = self._writer.register_channel(
                channel.topic, channel.message_encoding, self._schema_id(channel.schema_id), channel.metadata
            )
            self._channel_ids[message.channel_id] = channel_id
        self._writer.add_message(channel_id, message.log_time, message.data, message.publish_time, message.sequence)
        self.messages += 1

    def _watch(self, channel: Channel, message: Message) -> None:
        """Give a message to the deriver, as the recorder does: all of one time first, then all that are due then."""
        if self._visual is None:
            return
        if self._now_ns is not None and message.log_time != self._now_ns:
            self._draw()
        self._now_ns = message.log_time
        topic = topic_named_by(channel.topic)
        if topic is not None:
            self._visual.handle(topic, channel.topic, message.data)

    def _draw(self) -> None:
        if self._visual is None or self._now_ns is None:
            return
        for derived in self._visual.due(self._now_ns):
            self._writer.add_message(self._visual_id(derived), self._now_ns, derived.data(), derived.stamp_ns)
            self.visual_messages += 1

    def _visual_id(self, derived: VisualMessage) -> int:
        if derived.channel not in self._visual_ids:
            name, encoding, text = derived.schema()
            if name not in self._visual_schemas:
                self._visual_schemas[name] = self._writer.register_schema(name, encoding, text)
            self._visual_ids[derived.channel] = self._writer.register_channel(
                derived.channel, derived.encoding, self._visual_schemas[name]
            )
        return self._visual_ids[derived.channel]

    def _schema_id(self, source_id: int) -> int:
        schema = self._schemas.get(source_id)
        if schema is None:
            return 0
        if source_id not in self._schema_ids:
            self._schema_ids[source_id] = self._writer.register_schema(schema.name, schema.encoding, schema.data)
        return self._schema_ids[source_id]


class Recovery(msgspec.Struct, frozen=True, kw_only=True):
    """The result of a recovery."""

    source: Path
    path: Path
    messages: int
    bytes: int
    """Size of the new file."""
    was_truncated: bool
    damaged_chunks: int
    """Chunks in the middle that could not be read, and whose messages are lost."""
    undescribed: int
    """Messages of keys that were described in a damaged chunk only; they are lost as well."""
    unread_bytes: int
    """Bytes at the end of the source that could not be read."""


def recover(source: Path, path: Path, on_progress: Callable[[float], None] | None = None) -> Recovery:
    """Write all readable messages of `source` to a new file with index and summary; its metadata lists the losses.

    Messages, schemas, metadata and attachments are taken over as they are.

    Args:
        source: an MCAP file.
        path: a file that does not exist yet.
        on_progress: called with the share of the source that has been read, 0 to 1.

    Raises:
        RecordingError: the source is no recording, or the new file exists or cannot be written; none is left then.
    """
    copy = _copied(source, path, None, on_progress)
    return Recovery(
        source=source,
        path=path,
        messages=copy.messages,
        bytes=path.stat().st_size,
        was_truncated=copy.truncated,
        damaged_chunks=copy.damaged_chunks,
        undescribed=copy.undescribed,
        unread_bytes=copy.unread_bytes,
    )


def with_visual(source: Path, path: Path, on_progress: Callable[[float], None] | None = None) -> int:
    """Write a copy of a recording with channels for viewers such as Foxglove; returns the number of added messages.

    As `recover`; channels of that kind which the source has are made again.
    """
    return _copied(source, path, FoxgloveChannels(), on_progress).visual_messages


def _copied(
    source: Path, path: Path, visual: FoxgloveChannels | None, on_progress: Callable[[float], None] | None
) -> RecordingCopy:
    check_readable(source)
    truncated = is_truncated(source)
    with writing(path):
        target = path.open("xb")
    try:
        with writing(path, "; free some space"), target:
            copy = RecordingCopy(target, visual, truncated=truncated)
            with describing_damage(source):
                stream = source.open("rb")
            with stream:
                if not truncated:
                    with describing_damage(source):
                        copy.read_descriptions(stream)
                _copy_records(source, stream, copy, on_progress)
            copy.finish()
    except BaseException:  # also Ctrl-C: half a copy must not pass for a recording
        path.unlink(missing_ok=True)
        raise
    if on_progress is not None:
        on_progress(1.0)
    return copy


def _copy_records(
    source: Path, stream: BufferedReader, copy: RecordingCopy, on_progress: Callable[[float], None] | None
) -> None:
    size_bytes = os.fstat(stream.fileno()).st_size
    records = StreamReader(whole_reads(stream), emit_chunks=True).records
    whole_bytes = 0
    while not copy.ended:
        try:
            record = next(records, None)
        except (EndOfFile, *DAMAGE):
            break  # records after one whose length is wrong cannot be found
        except OSError as error:
            raise RecordingError(source, f"cannot read {source}: {error.strerror or error}") from error
        if record is None:
            break
        whole_bytes = stream.tell()
        copy.handle(record)
        if on_progress is not None:
            on_progress(whole_bytes / size_bytes)
    copy.unread_bytes = 0 if copy.ended and not copy.truncated else size_bytes - whole_bytes
