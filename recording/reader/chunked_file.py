"""A recording as a list of chunks, each readable separately, for seeking."""

import os
import struct
from collections import OrderedDict
from io import BufferedReader, BytesIO
from pathlib import Path
from typing import NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import breakup_chunk
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from robrain.recording.errors import RecordingError
from robrain.recording.reader.reading import check_readable, describing_damage, is_truncated, recorded_message
from robrain.recording.reader.recorded_message import RecordedMessage

CACHED_CHUNKS = 32
"""Chunks kept in memory after they were read: those around the current place."""
RECORD_HEADER = struct.Struct("<BQ")


class ChunkPlace(NamedTuple):
    """Place and content of a chunk."""

    offset: int
    start_ns: int
    end_ns: int
    channels: tuple[int, ...]
    """Ids of the channels that have a message in it."""


class ChunkedFile:
    """Reads any place of a recording; a file without its end is read through once first.

    Args:
        path: an MCAP file.

    Raises:
        RecordingError: there is no such file, it is no recording, its messages are not in chunks, or it is damaged.
    """

    def __init__(self, path: Path) -> None:
        check_readable(path)
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.counts: dict[int, int] = {}
        """Messages of each channel id."""
        self.chunks: list[ChunkPlace] = []
        """In the order of the file, without chunks that hold no message."""
        self.truncated = is_truncated(path)
        self._cached: OrderedDict[int, list[RecordedMessage]] = OrderedDict()
        with describing_damage(path), path.open("rb") as stream:
            summary = None if self.truncated else make_reader(stream).get_summary()
            if summary is not None:
                self._handle_summary(summary)
            if not self.chunks:
                self._scan(stream)
        self.start_ns = min((chunk.start_ns for chunk in self.chunks), default=0)
        """The run's clock at the first message; 0 when there is none."""
        self.end_ns = max((chunk.end_ns for chunk in self.chunks), default=0)
        """The run's clock at the last message; 0 when there is none."""

    def read(self, number: int) -> list[RecordedMessage]:
        """The messages of chunk `number`, in the order of the file; not to be written to.

        Raises:
            RecordingError: the chunk is damaged.
        """
        messages = self._cached.get(number)
        if messages is None:
            messages = self._cached[number] = self._read(number)
            if len(self._cached) > CACHED_CHUNKS:
                self._cached.popitem(last=False)
        else:
            self._cached.move_to_end(number)
        return messages

    def _handle_summary(self, summary: Summary) -> None:
        self.channels, self.schemas = summary.channels, summary.schemas
        if summary.statistics is not None:
            self.counts = summary.statistics.channel_message_counts
        self.chunks = [
            ChunkPlace(
                index.chunk_start_offset,
                index.message_start_time,
                index.message_end_time,
                tuple(index.message_index_offsets),
            )
            for index in sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)
            if index.message_index_offsets
        ]

    def _scan(self, stream: BufferedReader) -> None:
        """Find the chunks of a file without an index, as far as it is whole."""
        size_bytes = stream.seek(0, os.SEEK_END)
        offset = len(MCAP0_MAGIC)
        while offset + RECORD_HEADER.size <= size_bytes:
            stream.seek(offset)
            opcode, size = RECORD_HEADER.unpack(stream.read(RECORD_HEADER.size))
            end = offset + RECORD_HEADER.size + size
            if end > size_bytes or opcode in (0, Opcode.DATA_END):  # zeros stand where a disk had not got the rest
                break
            if opcode == Opcode.MESSAGE:
                raise RecordingError(
                    self.path, f"{self.path} has no chunks to seek in: `robrain recover` writes a copy that has"
                )
            if opcode in (Opcode.CHUNK, Opcode.CHANNEL, Opcode.SCHEMA):
                data = stream.read(size)
                if opcode == Opcode.CHUNK:
                    chunk = Chunk.read(ReadDataStream(BytesIO(data)))
                    present = self._channels_in(chunk)
                    if present:
                        place = ChunkPlace(offset, chunk.message_start_time, chunk.message_end_time, tuple(present))
                        self.chunks.append(place)
                else:
                    kind = Channel if opcode == Opcode.CHANNEL else Schema
                    self._describe(kind.read(ReadDataStream(BytesIO(data))))
            offset = end

    def _channels_in(self, chunk: Chunk) -> dict[int, None]:
        """Ids of the channels with messages in a chunk, in order of appearance."""
        present: dict[int, None] = {}
        for record in breakup_chunk(chunk):
            if isinstance(record, Message):
                present[record.channel_id] = None
                self.counts[record.channel_id] = self.counts.get(record.channel_id, 0) + 1
            else:
                self._describe(record)
        return present

    def _describe(self, record: McapRecord) -> None:
        if isinstance(record, Channel):
            self.channels[record.id] = record
        elif isinstance(record, Schema):
            self.schemas[record.id] = record

    def _read(self, number: int) -> list[RecordedMessage]:
        with describing_damage(self.path):
            # Opened for each chunk, which costs little beside it: no caller has to close a file that is read.
            with self.path.open("rb") as stream:
                stream.seek(self.chunks[number].offset + RECORD_HEADER.size)
                chunk = Chunk.read(ReadDataStream(stream))
            return [
                recorded_message(self.channels[record.channel_id], record)
                for record in breakup_chunk(chunk, validate_crc=True)
                if isinstance(record, Message)
            ]
