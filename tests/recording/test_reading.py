from pathlib import Path

import msgspec
import pytest
import zenoh
from mcap.writer import Writer

from robrain.protocol.messages.robots.plugin_messages import ROBOT_LOG, LogRecord
from robrain.recording.errors import RecordingError
from robrain.recording.provenance import Provenance
from robrain.recording.reader.reading import read_messages, read_provenance, recording_info
from robrain.recording.reader.recorded_message import RecordedMessage
from robrain.recording.writer.recorder import RecordingSummary
from tests.recording import stage

PROVENANCE = msgspec.structs.replace(stage.PROVENANCE, scenario_toml="robots = 3\n" * 50, map_png=b"\x89PNG" * 40)
START_NS = 3_000_000_000
STEP_NS = 100_000_000
STEPS = 40
LOG_KEYS = {robot: f"robrain/default/robot/{robot}/log" for robot in ("r1", "r2")}


def record(session: zenoh.Session, path: Path, provenance: Provenance = PROVENANCE) -> RecordingSummary:
    """Two robots log, 0.1 s apart."""
    played = stage.Stage(session, START_NS / 1e9)
    recorder = played.recorder(path, provenance)
    publishers = {robot: played.speaker.publisher(ROBOT_LOG, robot=robot) for robot in LOG_KEYS}
    for step in range(STEPS):
        for robot, publisher in publishers.items():
            publisher.put(LogRecord(robot=robot, level="info", source="test", text=f"{step}" * 20))
        recorder.step()
        played.pass_time()
    summary = recorder.close()
    played.close()
    return summary


@pytest.fixture
def recording(session: zenoh.Session, tmp_path: Path) -> Path:
    path = tmp_path / "run.mcap"
    record(session, path)
    return path


def cut(path: Path, size_bytes: int) -> Path:
    truncated = path.with_name("truncated.mcap")
    truncated.write_bytes(path.read_bytes()[:size_bytes])
    return truncated


def test_messages_are_read_in_the_order_they_were_recorded(recording: Path) -> None:
    messages = list(read_messages(recording))
    assert [message.topic_key for message in messages] == list(LOG_KEYS.values()) * STEPS
    assert [message.log_time_ns for message in messages[::2]] == [START_NS + n * STEP_NS for n in range(STEPS)]
    assert {message.encoding for message in messages} == {"json"}


@pytest.mark.parametrize("map_png", [None, b"", b"\x89PNG"])
@pytest.mark.parametrize("scenario_toml", ["", "name = 'Büro'\r\n"])
def test_provenance_is_read_as_it_was_written(
    session: zenoh.Session, tmp_path: Path, map_png: bytes | None, scenario_toml: str
) -> None:
    path = tmp_path / "run.mcap"
    written = Provenance("", scenario_toml, -1, map_png, "live", "team-1")
    record(session, path, written)
    assert read_provenance(path) == written


@pytest.mark.slow
def test_a_file_cut_anywhere_gives_its_first_messages_and_its_provenance(recording: Path) -> None:
    whole = list(read_messages(recording))
    size_bytes = recording.stat().st_size
    front_bytes = len(PROVENANCE.scenario_toml) + len(PROVENANCE.map_png or b"") + 800
    seen = set()
    for kept_bytes in range(front_bytes, size_bytes, 41):
        truncated = cut(recording, kept_bytes)
        messages = list(read_messages(truncated))
        assert messages == whole[: len(messages)]
        assert read_provenance(truncated) == PROVENANCE
        seen.add(len(messages))
    assert 0 in seen
    assert len(whole) in seen
    assert len(seen) > 5


def test_damage_is_told_after_the_messages_before_it(recording: Path) -> None:
    whole = list(read_messages(recording))
    content = bytearray(recording.read_bytes())
    damaged_chunk = content.rindex(b"\x28\xb5\x2f\xfd", 0, len(content) // 2)  # a zstd frame
    content[damaged_chunk + 20] ^= 0xFF
    recording.write_bytes(content)
    messages: list[RecordedMessage] = []
    with pytest.raises(RecordingError, match="damaged") as caught:
        messages.extend(read_messages(recording))
    assert caught.value.path == recording
    assert 0 < len(messages) < len(whole)
    assert messages == whole[: len(messages)]


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("missing.mcap", None, "there is no file"),
        ("empty.mcap", b"", "is empty"),
        ("text.mcap", b"robots = 3\n", "is not an MCAP file"),
        ("short.mcap", b"\x89MC", "is not an MCAP file"),
        (".", None, "is a folder"),
    ],
)
def test_what_is_no_recording_is_told_in_a_sentence(
    tmp_path: Path, name: str, content: bytes | None, says: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    for read in (read_messages, read_provenance, recording_info):
        with pytest.raises(RecordingError, match=says) as caught:
            read(path)
        assert caught.value.path == path
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_a_recording_of_another_tool_is_read_but_has_no_provenance(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=False, use_statistics=False)
        writer.start()
        channel_id = writer.register_channel("/chatter", "ros1", 0)
        writer.add_message(channel_id, log_time=2_000_000_000, data=b"b", publish_time=0)
        writer.add_message(channel_id, log_time=1_000_000_000, data=b"a", publish_time=0)
        writer.finish()  # type: ignore[no-untyped-call]
    assert list(read_messages(path)) == [
        RecordedMessage("/chatter", 2_000_000_000, b"b", "ros1"),
        RecordedMessage("/chatter", 1_000_000_000, b"a", "ros1"),
    ]
    info = recording_info(path)
    assert (info.counts, info.start_ns, info.duration_s) == ({"/chatter": 2}, 1_000_000_000, 1.0)
    assert (info.versions, info.digest, info.truncated) == ({}, "", False)
    with pytest.raises(RecordingError, match="has no information about its run"):
        read_provenance(path)
