"""Writes an MCAP file whose messages are packed a chunk at a time.

The records are those of the package `mcap`, whose own writer makes objects and a dozen small writes of each message: at
ten thousand a second that alone is a twentieth of a core. Here a message is one header and its payload, as they are.
"""

import struct
import zlib
from collections import defaultdict
from collections.abc import Mapping
from typing import Protocol

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

COMPRESSION = "zstd"
_MESSAGE = struct.Struct("<BQHIQQ")
"""Opcode, length, channel, sequence, log time and publish time of a message record; its payload follows."""
_MESSAGE_FIXED_BYTES = 22
"""What the length of a message record counts beside the payload."""
_INDEX = struct.Struct("<BQHI")
"""Opcode, length, channel and bytes of a message index; pairs of log time and offset follow."""
_FOOTER = struct.Struct("<BQQQ")
"""The part of a footer that its checksum covers."""
_FOOTER_BYTES = 20


class Output(Protocol):
    """Where the bytes go."""

    def write(self, data: bytes, /) -> int:
        """Write all of it."""

    def tell(self) -> int:
        """Bytes written so far."""


class ChunkWriter:
    """Writes records, and messages in chunks; a chunk ends with `flush` and nowhere else.

    Args:
        output: where to write; not closed by the writer. What it raises passes through, and the file is then as far
            as it had been written: there is no going on.
    """

    def __init__(self, output: Output) -> None:
        self._output = output
        self._compressor = zstandard.ZstdCompressor()
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._chunks: list[ChunkIndex] = []
        self._counts: defaultdict[int, int] = defaultdict(int)
        self._parts: list[bytes] = []
        self._size = 0
        self._places: dict[int, list[int]] = {}

    def start(self, profile: str, library: str) -> None:
        """Begin the file: what kind of recording it is, and who writes it."""
        self._output.write(MCAP0_MAGIC)
        self._write(Header(profile, library))

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write words under a name."""
        offset = self._output.tell()
        length = self._write(Metadata(name=name, metadata=values))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write a file into the file."""
        offset = self._output.tell()
        length = self._write(Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data))
        self._attachments.append(
            AttachmentIndex(
                offset=offset,
                length=length,
                create_time=0,
                log_time=0,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Tell of a schema; returns its number."""
        schema = Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        self._schemas.append(schema)
        self._put(_packed(schema))
        return schema.id

    def register_channel(
        self, topic: str, encoding: str, schema_id: int, metadata: Mapping[str, str] | None = None
    ) -> int:
        """Add a channel and return its number.

        Args:
            topic: name of the channel.
            encoding: of its messages.
            schema_id: number of its schema, 0 for none.
            metadata: further facts about the channel.

        """
        number = len(self._channels) + 1
        told = dict(metadata or {})
        channel = Channel(id=number, topic=topic, message_encoding=encoding, schema_id=schema_id, metadata=told)
        self._channels.append(channel)
        self._put(_packed(channel))
        return channel.id

    def add_message(
        self, channel_id: int, log_time_ns: int, payload: bytes, publish_time_ns: int, sequence: int = 0
    ) -> None:
        """Take a message into the chunk that is being made."""
        length = len(payload) + _MESSAGE_FIXED_BYTES
        header = _MESSAGE.pack(Opcode.MESSAGE, length, channel_id, sequence, log_time_ns, publish_time_ns)
        places = self._places.get(channel_id)
        if places is None:
            places = self._places[channel_id] = []
        places += (log_time_ns, self._size)
        self._parts += (header, payload)
        self._size += length + 9

    def flush(self) -> None:
        """End the chunk and write it; one without messages stays until there are some."""
        if not self._places:
            return
        records = b"".join(self._parts)
        times = [log_time_ns for places in self._places.values() for log_time_ns in places[::2]]
        start_ns, end_ns = min(times), max(times)
        packed = self._compressor.compress(records)
        offset = self._output.tell()
        length = self._write(
            Chunk(
                compression=COMPRESSION,
                data=packed,
                message_start_time=start_ns,
                message_end_time=end_ns,
                uncompressed_crc=zlib.crc32(records),
                uncompressed_size=len(records),
            )
        )
        offsets, indexes = self._message_indexes(offset + length)
        self._output.write(indexes)
        self._chunks.append(
            ChunkIndex(
                message_start_time=start_ns,
                message_end_time=end_ns,
                chunk_start_offset=offset,
                chunk_length=length,
                message_index_offsets=offsets,
                message_index_length=len(indexes),
                compression=COMPRESSION,
                compressed_size=len(packed),
                uncompressed_size=len(records),
            )
        )
        for channel_id, places in self._places.items():
            self._counts[channel_id] += len(places) // 2
        self._parts.clear()
        self._places.clear()
        self._size = 0

    def finish(self) -> None:
        """Write what is left, the index of the file and its end."""
        self.flush()
        self._write(DataEnd(0))
        start = self._output.tell()
        groups: tuple[tuple[Opcode, list[McapRecord]], ...] = (
            (Opcode.SCHEMA, [*self._schemas]),
            (Opcode.CHANNEL, [*self._channels]),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, [*self._chunks]),
            (Opcode.ATTACHMENT_INDEX, [*self._attachments]),
            (Opcode.METADATA_INDEX, [*self._metadata]),
        )
        summary = b""
        offsets: list[McapRecord] = []
        for opcode, records in groups:
            if not records:
                continue
            group = _packed(*records)
            offsets.append(
                SummaryOffset(group_opcode=opcode, group_start=start + len(summary), group_length=len(group))
            )
            summary += group
        offset_start = start + len(summary)
        summary += _packed(*offsets)
        checked = _FOOTER.pack(Opcode.FOOTER, _FOOTER_BYTES, start, offset_start)
        crc = zlib.crc32(checked, zlib.crc32(summary))
        self._output.write(summary)
        self._write(Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=crc))
        self._output.write(MCAP0_MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            metadata_count=len(self._metadata),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            schema_count=len(self._schemas),
        )

    def _message_indexes(self, start: int) -> tuple[dict[int, int], bytes]:
        """Where the index of each channel begins, and the indexes, which begin at `start`."""
        offsets: dict[int, int] = {}
        parts: list[bytes] = []
        for channel_id, places in self._places.items():
            offsets[channel_id] = start
            pairs = struct.pack(f"<{len(places)}Q", *places)
            header = _INDEX.pack(Opcode.MESSAGE_INDEX, len(pairs) + 6, channel_id, len(pairs))
            parts += (header, pairs)
            start += len(header) + len(pairs)
        return offsets, b"".join(parts)

    def _put(self, record: bytes) -> None:
        self._parts.append(record)
        self._size += len(record)

    def _write(self, record: McapRecord) -> int:
        packed = _packed(record)
        self._output.write(packed)
        return len(packed)


def _packed(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    packed: bytes = builder.end()  # type: ignore[no-untyped-call]  # mcap leaves it unannotated
    return packed
