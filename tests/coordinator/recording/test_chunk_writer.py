"""Our writer of MCAP against the package's reader: whatever is written is read again, in order and by its index."""

from io import BytesIO

from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import LIBRARY_IDENTIFIER, Writer

from robrain.coordinator.recording.writer.chunk_writer import ChunkWriter

TIMES = st.integers(0, 2**63 - 1)
MESSAGES = st.lists(
    st.tuples(st.integers(1, 3), TIMES, st.binary(max_size=50), TIMES, st.integers(0, 2**32 - 1), st.booleans()),
    max_size=30,
)


def begun(stream: BytesIO) -> ChunkWriter:
    writer = ChunkWriter(stream)
    writer.start("robrain", LIBRARY_IDENTIFIER)
    writer.add_metadata("about", {"seed": "7"})
    writer.add_attachment("map.png", "image/png", b"\x89PNG")
    schema = writer.register_schema("robrain.Thing", "jsonschema", b'{"type":"object"}')
    for name in ("a", "b", "c"):
        writer.register_channel(name, "json", schema if name != "c" else 0)
    return writer


@given(MESSAGES)
def test_what_is_written_is_read_again(messages: list[tuple[int, int, bytes, int, int, bool]]) -> None:
    stream = BytesIO()
    writer = begun(stream)
    for channel, log_time, payload, publish_time, sequence, ends_chunk in messages:
        writer.add_message(channel, log_time, payload, publish_time, sequence)
        if ends_chunk:
            writer.flush()
    writer.finish()
    said = [(channel, log, payload, publish, number) for channel, log, payload, publish, number, _ in messages]
    stream.seek(0)
    read = NonSeekingReader(stream, validate_crcs=True).iter_messages(log_time_order=False)
    assert [(m.channel_id, m.log_time, m.data, m.publish_time, m.sequence) for _, _, m in read] == said
    stream.seek(0)
    reader = make_reader(stream, validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(said)
    times = [log_time for _, log_time, *_ in said] or [0]
    assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (min(times), max(times))
    for number, channel in summary.channels.items():
        by_index = [m.data for _, _, m in reader.iter_messages(topics=[channel.topic])]
        assert sorted(by_index) == sorted(payload for n, _, payload, *_ in said if n == number)
        assert summary.statistics.channel_message_counts.get(number, 0) == len(by_index)
    assert [(record.name, record.metadata) for record in reader.iter_metadata()] == [("about", {"seed": "7"})]
    assert [(record.name, record.data) for record in reader.iter_attachments()] == [("map.png", b"\x89PNG")]


def test_a_file_is_the_one_that_the_packages_own_writer_makes() -> None:
    ours, theirs = BytesIO(), BytesIO()
    writer = begun(ours)
    reference = Writer(theirs)
    reference.start("robrain", LIBRARY_IDENTIFIER)
    reference.add_metadata("about", {"seed": "7"})
    reference.add_attachment(0, 0, "map.png", "image/png", b"\x89PNG")
    schema = reference.register_schema("robrain.Thing", "jsonschema", b'{"type":"object"}')
    for name in ("a", "b", "c"):
        reference.register_channel(name, "json", schema if name != "c" else 0)
    for number in range(20):
        for one in (writer, reference):
            one.add_message(1 + number % 3, 1000 + number, b"{}" * number, number, number)
            if number % 7 == 6:
                one.flush()
    writer.finish()
    reference.finish()
    assert ours.getvalue() == theirs.getvalue()
