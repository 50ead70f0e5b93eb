"""Older recordings: their tasks and reasons get today's form where messages are read."""

from pathlib import Path

import msgspec
import pytest
from mcap.records import Channel, Message

from robrain.protocol.model.tasks.old_form import upgraded_json
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.reasons import NearestOut, PlainReason
from robrain.protocol.table.topics import COORDINATOR_STATE, TASK_EVENT
from robrain.recording.reader.reading import recorded_message

GOLDEN = Path(__file__).parents[1] / "protocol" / "golden"
OLD = sorted((GOLDEN / "old_tasks").glob("*.json"))


def channel(topic: str) -> Channel:
    return Channel(id=1, message_encoding="json", metadata={}, schema_id=1, topic=topic)


@pytest.mark.parametrize("old", OLD, ids=lambda old: old.stem)
def test_an_event_of_an_old_task_is_read(old: Path) -> None:
    today = msgspec.json.decode((GOLDEN / "tasks" / old.name).read_bytes(), type=Task)
    payload = b'{"stamp_ns":7,"task":' + old.read_bytes() + b',"state":"done","robot":"r1"}'
    found = recorded_message(channel(TASK_EVENT.key("default")), Message(1, 8, payload, 7, 3))
    event = TASK_EVENT.payloads.read(found.payload)
    assert event.task == today
    assert (found.log_time_ns, found.publish_time_ns, found.sequence, event.robot) == (8, 7, 3, "r1")


def test_what_is_no_task_is_read_as_it_was_written() -> None:
    payload = b'{"task":{"id":"visit"},  "x":1}'
    assert recorded_message(channel("robrain/default/robot/r1/state"), Message(1, 8, payload, 7, 3)).payload == payload


def test_old_reasons_are_read_with_their_kind_sentence_and_values() -> None:
    gave_up = b'{"code":"gave_up","because":{"code":"nearest_out","robot":"r1","because":{"code":"crowded"}}}'
    task = (GOLDEN / "tasks" / "visit.json").read_bytes()
    payload = b'{"task":' + task + b',"state":"failed","why":"nobody can do it","reason":' + gave_up + b"}"
    event = TASK_EVENT.payloads.read(
        recorded_message(channel(TASK_EVENT.key("default")), Message(1, 8, payload, 7, 3)).payload
    )
    assert event.reason == PlainReason("nobody can do it", "gave_up")
    idle = b'{"name":"r1","up":true,"age_s":0.1,"why":"idle","idle":{"code":"no_way","frontiers":2,"needed_m":0.5}}'
    payload = b'{"robots":[' + idle + b'],"refused":[{"topic":"t","key":"k","code":"failed","count":1,"why":""}]}'
    found = recorded_message(channel(COORDINATOR_STATE.key("default")), Message(1, 8, payload, 7, 3)).payload
    state = COORDINATOR_STATE.payloads.read(found)
    assert state.robots[0].idle == PlainReason("idle", "no_way", {"frontiers": 2, "needed_m": 0.5})
    assert state.refused[0].code == "failed"
    nearest = {"robot": "r1", "because": {"code": "crowded"}, "code": "nearest_out"}
    decoded = msgspec.json.decode(upgraded_json(b'{"reason":' + msgspec.json.encode(nearest) + b"}"))["reason"]
    assert msgspec.convert(decoded, NearestOut) == NearestOut("r1", PlainReason("crowded", "crowded"))
