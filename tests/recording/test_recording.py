import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zenoh
from jsonschema import Draft202012Validator
from mcap.reader import make_reader

from robrain.protocol.messages.message import Message
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT, ROBOT_LOG, LogRecord, PluginEvent
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.messages.team.arena_messages import ARENA_CLOCK, ArenaClock
from robrain.protocol.messages.team.team_messages import HALT, Halt
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.table.topics import all_topics
from robrain.protocol.topic import Topic
from robrain.protocol.workers import OwnedThread
from robrain.recording.errors import RecordingError
from robrain.recording.writer import recording_file
from robrain.recording.writer.recorder import RecordingSummary
from tests.recording.stage import LINE, Stage

GOLDEN = Path(__file__).parents[1] / "protocol" / "golden"
STEP_NS = 100_000_000


def state(x_m: float) -> RobotState:
    return RobotState(robot="r1", pose=Pose2D(x_m, 2.0, 0.5))


def record_a_run(stage: Stage, path: Path | None, *, steps: int = 30) -> RecordingSummary:
    """A robot drives, logs and tells an event, for 0.1 s a step."""
    recorder = stage.recorder(path)
    states = stage.speaker.publisher(ROBOT_STATE, robot="r1")
    logs = stage.speaker.publisher(ROBOT_LOG, robot="r1")
    events = stage.speaker.publisher(ROBOT_EVENT, robot="r1", plugin="bumper", event="hit")
    for step in range(steps):
        states.put(state(step / 10))
        logs.put(LogRecord(robot="r1", level="info", source="test", text=f"step {step}"))
        if step % 10 == 0:
            events.put(PluginEvent(robot="r1", plugin="bumper", event="hit", value={"side": "left"}))
        recorder.step()
        stage.pass_time()
    return recorder.close()


def messages_in(path: Path) -> list[tuple[Any, Any, Any]]:
    with path.open("rb") as stream:
        return list(make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False))


def say(session: zenoh.Session, said: list[tuple[Topic, dict[str, str], Message]]) -> str:
    """Digest of a run in which this was said, in this order."""
    stage = Stage(session)
    recorder = stage.recorder(None)
    for topic, names, message in said:
        stage.speaker.publisher(topic, **names).put(message)
        recorder.step()
        stage.pass_time()
    digest = recorder.close().digest
    stage.close()
    return digest


def test_mcaps_own_reader_finds_each_message_as_it_was_on_the_wire(stage: Stage, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    summary = record_a_run(stage, path)
    recorded = messages_in(path)
    assert summary.messages == len(recorded) == 63
    assert summary.bytes == path.stat().st_size
    assert summary.path == path
    assert (summary.outside, summary.dropped, summary.lost) == (0, 0, 0)
    states = [message for _, channel, message in recorded if channel.topic == "robrain/default/robot/r1/state"]
    expected = [msgspec.structs.replace(state(n / 10), stamp_ns=n * STEP_NS, seq=n) for n in range(30)]
    assert [message.data for message in states] == [msgspec.json.encode(message) for message in expected]
    assert [message.sequence for message in states] == list(range(30))
    assert [message.publish_time for message in states] == [n * STEP_NS for n in range(30)]
    assert [message.log_time for message in states] == [n * STEP_NS for n in range(30)]


@pytest.mark.slow
@pytest.mark.parametrize(
    "topic",
    [topic for topic in all_topics() if topic.recorded and topic.message is not None],
    ids=lambda topic: topic.name,
)
def test_every_recorded_topic_is_heard_and_has_a_schema_that_is_an_object(
    stage: Stage, tmp_path: Path, topic: Topic
) -> None:
    path = tmp_path / "run.mcap"
    recorder = stage.recorder(path)
    assert topic.message is not None
    said = json.loads(next(GOLDEN.rglob(f"{topic.message.__name__}.json")).read_bytes()) | {"stamp_ns": 5}
    names = {field: said.get(field, "x1") for field in topic.fields}
    stage.speaker.publisher(topic, **names).put_bytes(json.dumps(said).encode())
    recorder.close()
    [(schema, channel, message)] = messages_in(path)
    assert channel.topic == topic.key("default", **names)
    assert message.data == json.dumps(said).encode()
    Draft202012Validator(json.loads(channel.metadata["json_schema"])).validate(said)
    described = json.loads(schema.data)
    assert described["type"] == "object"
    assert "stamp_ns" in described["properties"]


def test_what_is_not_to_be_recorded_is_not(stage: Stage) -> None:
    recorder = stage.recorder(None)
    stage.speaker.publisher(ARENA_CLOCK).put(ArenaClock(sim_time_s=1.0))
    assert recorder.close().messages == 0


@pytest.mark.parametrize(
    "payload",
    [
        b"not json",
        b"\xff\xfe",
        b"",
        b"[]",
        LINE[:-1] + b',"stamp_ns":"soon"}',
        LINE[:-1] + b',"stamp_ns":99999999999999999999999}',  # more than 64 bits
        LINE[:-1] + b',"seq":1.5}',
        b'{"robot":"r1"}',
    ],
)
def test_what_breaks_the_contract_of_its_topic_is_not_recorded_and_counted(
    stage: Stage, tmp_path: Path, payload: bytes
) -> None:
    path = tmp_path / "run.mcap"
    recorder = stage.recorder(path)
    stage.speaker.publisher(ROBOT_LOG, robot="r1").put_bytes(payload)
    stage.speaker.publisher(ROBOT_LOG, robot="r1").put_bytes(LINE)
    recorder.step()
    (refusal,) = recorder.refused
    assert (refusal.topic, refusal.key, refusal.code) == ("robot_log", "robrain/default/robot/r1/log", "malformed")
    assert recorder.close().messages == 1
    [(_, _, message)] = messages_in(path)
    assert message.data == LINE


def test_a_message_without_a_stamp_is_recorded_with_the_time_it_was_heard(stage: Stage, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorder = stage.recorder(path)
    stage.pass_time()
    stage.speaker.publisher(ROBOT_LOG, robot="r1").put_bytes(LINE)
    recorder.close()
    [(_, _, message)] = messages_in(path)
    assert (message.publish_time, message.sequence) == (STEP_NS, 0)


def test_equal_runs_leave_equal_files_and_digests(session: zenoh.Session, tmp_path: Path) -> None:
    summaries = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        stage = Stage(session)
        summaries.append(record_a_run(stage, tmp_path / name / "run.mcap"))
        stage.close()
    assert summaries[0].digest == summaries[1].digest
    assert (tmp_path / "one/run.mcap").read_bytes() == (tmp_path / "two/run.mcap").read_bytes()


def test_the_digest_can_be_worked_out_from_the_file(stage: Stage, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    summary = record_a_run(stage, path)
    digest = hashlib.sha256()
    for _, channel, message in messages_in(path):
        key = channel.topic.encode()
        digest.update(len(key).to_bytes(8, "little") + key)
        digest.update(message.publish_time.to_bytes(8, "little"))
        digest.update(len(message.data).to_bytes(8, "little") + message.data)
    assert summary.digest == digest.hexdigest()


ROBOT_1 = {"robot": "r1"}
SAID: list[tuple[Topic, dict[str, str], Message]] = [
    (ROBOT_STATE, ROBOT_1, state(1.0)),
    (ROBOT_LOG, ROBOT_1, LogRecord(robot="r1", level="info", source="a", text="b")),
    (HALT, {}, Halt(halted=True, by="operator")),
]


@pytest.mark.parametrize(
    "other",
    [
        SAID[:2],
        [SAID[1], SAID[0], SAID[2]],  # another order
        [*SAID[:2], (HALT, {}, Halt(halted=True, by="operators"))],  # another payload
        [(ROBOT_STATE, {"robot": "r2"}, state(1.0)), *SAID[1:]],  # another key
        [*SAID, SAID[2]],
    ],
)
def test_a_run_in_which_something_else_was_said_has_another_digest(
    session: zenoh.Session, other: list[tuple[Topic, dict[str, str], Message]]
) -> None:
    assert say(session, SAID) == say(session, SAID)
    assert say(session, other) != say(session, SAID)


def test_messages_from_another_thread_count_as_outside_and_mark_the_digest(stage: Stage, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorder = stage.recorder(path)
    logs = stage.speaker.publisher(ROBOT_LOG, robot="r1")
    logs.put_bytes(LINE)
    recorder.step()
    assert len(recorder.digest) == 64
    for _ in range(2):
        outsider = OwnedThread("outsider", logs.put_bytes, LINE)
        outsider.close()
    summary = recorder.close()
    assert (summary.messages, summary.outside) == (3, 2)
    assert summary.digest.endswith("+outside:2")
    assert len(messages_in(path)) == 3


def test_closing_twice_returns_the_same_summary_and_what_comes_after_is_left_out(stage: Stage, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorder = stage.recorder(path)
    logs = stage.speaker.publisher(ROBOT_LOG, robot="r1")
    logs.put_bytes(LINE)
    summary = recorder.close()
    content = path.read_bytes()
    logs.put_bytes(LINE)
    recorder.step()
    assert recorder.close() is summary
    assert path.read_bytes() == content
    assert summary.messages == 1


def test_more_keys_than_mcap_can_number_are_counted_as_lost(
    stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording_file, "CHANNELS_MAX", 2)
    path = tmp_path / "run.mcap"
    recorder = stage.recorder(path)
    for robot in ("r1", "r2", "r3"):
        line = LogRecord(robot=robot, level="info", source="s", text="t")
        stage.speaker.publisher(ROBOT_LOG, robot=robot).put(line)
    summary = recorder.close()
    assert (summary.messages, summary.lost) == (3, 1)
    assert len(messages_in(path)) == 2


def test_a_digest_without_a_file_does_not_need_mcap(
    stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "robrain.recording.writer.recording_file")
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    assert stage.recorder(None).close().messages == 0
    with pytest.raises(RecordingError, match=r"pip install 'robrain\[team\]'"):
        stage.recorder(tmp_path / "run.mcap")
