"""The chunks of a recording: found by its index, or by reading through a file whose end is missing."""

from pathlib import Path

import pytest
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, Header, Message, Schema
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from robrain.recording.errors import RecordingError
from robrain.recording.reader.chunked_file import ChunkedFile

CHANNEL = Channel(id=3, topic="/a", message_encoding="json", metadata={}, schema_id=7)
SCHEMA = Schema(id=7, name="S", encoding="jsonschema", data=b"{}")


def message(stamp_ns: int, text: bytes = b"{}") -> Message:
    return Message(channel_id=3, log_time=stamp_ns, data=text, publish_time=stamp_ns + 1, sequence=stamp_ns + 2)


def written(*records: object) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)  # type: ignore[attr-defined]
    return builder.end()


def chunk(*records: object) -> Chunk:
    data = written(*records)
    stamps = [record.log_time for record in records if isinstance(record, Message)]
    return Chunk(compression="", data=data, message_start_time=min(stamps, default=0),
                 message_end_time=max(stamps, default=0), uncompressed_crc=0, uncompressed_size=len(data))  # fmt: skip


def without_end(path: Path, *records: object, tail: bytes = b"") -> ChunkedFile:
    """A file whose end is missing."""
    path.write_bytes(MCAP0_MAGIC + written(Header("", ""), *records) + tail)
    return ChunkedFile(path)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"


def times(found: ChunkedFile) -> list[list[int]]:
    return [[one.log_time_ns for one in found.read(number)] for number in range(len(found.chunks))]


def test_channels_and_schemas_outside_of_chunks_are_known(path: Path) -> None:
    found = without_end(path, SCHEMA, CHANNEL, chunk(message(5)))
    assert found.truncated
    assert (found.channels, found.schemas, found.counts) == ({3: CHANNEL}, {7: SCHEMA}, {3: 1})
    [one] = found.read(0)
    assert (one.topic_key, one.log_time_ns, one.publish_time_ns, one.sequence) == ("/a", 5, 6, 7)
    assert (one.payload, one.encoding) == (b"{}", "json")


def test_chunks_have_their_place_and_times_and_those_without_messages_are_left_out(path: Path) -> None:
    found = without_end(path, CHANNEL, chunk(message(9), message(4)), chunk(CHANNEL), chunk(message(20)))
    assert [(one.start_ns, one.end_ns, one.channels) for one in found.chunks] == [(4, 9, (3,)), (20, 20, (3,))]
    assert (found.start_ns, found.end_ns) == (4, 20)
    assert times(found) == [[9, 4], [20]]


@pytest.mark.parametrize(("missing", "chunks"), [(0, 2), (1, 1), (10_000, 0)])
def test_a_chunk_counts_when_it_is_whole(path: Path, missing: int, chunks: int) -> None:
    start = MCAP0_MAGIC + written(Header("", ""), CHANNEL)
    content = start + written(chunk(message(1)), chunk(message(2)))
    path.write_bytes(content[: max(len(content) - missing, len(start))])
    assert len(ChunkedFile(path).chunks) == chunks


@pytest.mark.parametrize("tail", [b"\x06", bytes(8), bytes(9), bytes(100), b"\x0f" + bytes(8)])
def test_zeros_and_half_a_record_at_the_end_are_not_read(path: Path, tail: bytes) -> None:
    assert times(without_end(path, CHANNEL, chunk(message(1)), tail=tail)) == [[1]]


def test_records_of_other_kinds_are_passed_over(path: Path) -> None:
    unknown = b"\x80" + (4).to_bytes(8, "little") + b"abcd"
    tail = unknown + written(chunk(message(2)))
    assert times(without_end(path, CHANNEL, chunk(message(1)), tail=tail)) == [[1], [2]]


def test_the_index_tells_the_same_as_reading_through(path: Path) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=100, compression=CompressionType.ZSTD)
        writer.start()
        channels = [writer.register_channel(f"/{name}", "json", 0) for name in "ab"]
        for k in range(40):
            writer.add_message(channels[k % 7 == 0], 100 + k, b"x" * 30, 0)
        writer.finish()  # type: ignore[no-untyped-call]
    indexed = ChunkedFile(path)
    cut = path.with_name("cut.mcap")
    cut.write_bytes(path.read_bytes()[:-1])
    scanned = ChunkedFile(cut)
    assert (indexed.truncated, scanned.truncated) == (False, True)
    assert [one._replace(channels=()) for one in indexed.chunks] == [
        one._replace(channels=()) for one in scanned.chunks
    ]
    assert [set(one.channels) for one in indexed.chunks] == [set(one.channels) for one in scanned.chunks]
    assert (indexed.counts, indexed.channels) == (scanned.counts, scanned.channels)
    assert times(indexed) == times(scanned)
    assert (indexed.start_ns, indexed.end_ns) == (scanned.start_ns, scanned.end_ns) == (100, 139)


def test_messages_outside_of_chunks_and_what_is_no_recording_are_refused(path: Path) -> None:
    with pytest.raises(RecordingError, match="no chunks to seek in"):
        without_end(path, CHANNEL, message(1))
    path.write_bytes(b"robots = 3, and more of it")
    with pytest.raises(RecordingError, match="not an MCAP"):
        ChunkedFile(path)


def test_a_chunk_whose_checksum_is_wrong_is_damaged(path: Path) -> None:
    wrong = chunk(message(1))
    wrong.uncompressed_crc = 1
    with pytest.raises(RecordingError, match="damaged"):
        without_end(path, CHANNEL, wrong).read(0)
