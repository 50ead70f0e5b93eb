"""Recordings from before kinds were open: their tasks get today's form where messages are read."""

from pathlib import Path

import msgspec
import pytest
from mcap.records import Channel, Message

from robrain.protocol.model.tasks.task import Task
from robrain.protocol.table.topics import TASK_EVENT
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
    payload = b'{"task":{"type":"visit"},  "x":1}'
    assert recorded_message(channel("robrain/default/robot/r1/state"), Message(1, 8, payload, 7, 3)).payload == payload
