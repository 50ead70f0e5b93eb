"""Messages are checked once, on entry; rejected ones are counted and reported."""

import logging
import re
from collections.abc import Sequence

import msgspec
import pytest

from robrain.protocol.border.border import Received
from robrain.protocol.border.record_guard import RecordGuard
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.errors import CallError
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP, ROBOT_MAP_WHOLE, MapPatch
from robrain.protocol.messages.motes.mote_messages import MOTE_READING, MoteReading
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT, ROBOT_LOG, LogRecord, PluginEvent
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT, TaskEvent
from robrain.protocol.messages.team.team_messages import HALT, Halt
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.refusals import KINDS_MAX, RefusalCode, Refusals
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session

LOGGER = "robrain.protocol.refusals"


@pytest.fixture
def clock():
    return VirtualClock()


@pytest.fixture
def wire(session, clock):
    endpoint = Endpoint(session, "t", clock, Drive.LOCKSTEP)
    yield endpoint
    endpoint.close()


@pytest.fixture
def inbox(wire):
    inbox = Inbox()
    for topic in (ROBOT_STATE, ROBOT_LOG, ROBOT_EVENT, MOTE_READING, TASK_EVENT, HALT):
        wire.subscribe(inbox, topic)
    return inbox


def map_of(robot):
    return MapPatch(robot=robot, resolution_m=0.1, origin_x_m=0.0, origin_y_m=0.0, width=10, height=10)


def refusals(wire):
    return [(one.topic, one.key, one.code, one.count) for one in wire.refusals.counts()]


@pytest.mark.parametrize(
    ("topic", "names", "message"),
    [
        (ROBOT_STATE, {"robot": "nobody"}, RobotState(robot="r1")),
        (ROBOT_LOG, {"robot": "nobody"}, LogRecord(robot="r1", level="info", source="x", text="y")),
        (ROBOT_EVENT, {"robot": "r1", "plugin": "a", "event": "e"}, PluginEvent(robot="r1", plugin="b", event="e")),
        (ROBOT_EVENT, {"robot": "r1", "plugin": "a", "event": "e"}, PluginEvent(robot="r1", plugin="a", event="f")),
        (
            MOTE_READING,
            {"mote": "m1"},
            MoteReading(mote="m2", place=None, quantity="q", value=1.0, voltage_v=3.0, rssi_dbm=-70.0, via="r1"),
        ),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_a_message_whose_sender_differs_from_its_key_is_rejected(wire, inbox, topic, names, message):
    wire.publisher(topic, **names).put(message)
    assert inbox.drain() == []
    assert refusals(wire) == [(topic.name, topic.key("t", **names), "wrong_name", 1)]


def test_a_message_whose_sender_matches_its_key_is_accepted(wire, inbox):
    wire.publisher(ROBOT_STATE, robot="r1").put(RobotState(robot="r1"))
    wire.publisher(TASK_EVENT).put(
        TaskEvent(task=Task(id="b", kind="visit", place=Point2D(0.0, 0.0)), state=TaskState.DONE)
    )
    assert {received.topic for received in inbox.drain()} == {ROBOT_STATE, TASK_EVENT}
    assert refusals(wire) == []


@pytest.mark.parametrize("pose", ['{"x_m":1e308,"y_m":0,"yaw_rad":0}', '{"x_m":0,"y_m":null,"yaw_rad":0}'])
def test_a_message_out_of_its_range_is_counted_with_its_sender(wire, inbox, pose):
    publisher = wire.publisher(ROBOT_STATE, robot="r1")
    for _ in range(3):
        publisher.put_bytes(f'{{"robot":"r1","pose":{pose}}}'.encode())
        assert inbox.drain() == []
    assert inbox.refused == 3
    (found,) = wire.refusals.counts()
    assert (found.topic, found.key, found.code, found.count) == (
        "robot_state",
        "robrain/t/robot/r1/state",
        "malformed",
        3,
    )
    assert "$.pose" in found.why


def test_a_message_larger_than_its_topic_allows_is_neither_sent_nor_heard(wire, inbox):
    halt = Halt(halted=True, by="ann", reason="x" * 2_000_000)
    publisher = wire.publisher(HALT)
    with pytest.raises(ValueError, match="at most 4096 bytes of halt"):
        publisher.put(halt)
    publisher.put_bytes(msgspec.json.encode(halt))
    assert inbox.drain() == []
    assert refusals(wire) == [("halt", HALT.key("t"), "too_large", 1)]
    publisher.put(Halt(halted=True, by="ann", reason="smoke"))
    assert [received.message.reason for received in inbox.drain()] == ["smoke"]


@pytest.mark.parametrize("ahead_s", [20 * 86_400.0, 54 * 365 * 86_400.0, -7200.0, 6.0, 2.0, -30.0])
def test_times_of_a_sender_whose_clock_differs_are_converted_to_the_receivers(wire, inbox, clock, ahead_s):
    now_s = 2e9
    clock.advance_to(to_ns(now_s))
    stamp_ns, by_s = to_ns(now_s + ahead_s), ahead_s if abs(ahead_s) > 5.0 and ahead_s != -30.0 else 0.0

    def own_ns(before_s):
        return to_ns(now_s + ahead_s - before_s) - to_ns(by_s)

    wire.publisher(ROBOT_STATE, robot="r1").put(RobotState(robot="r1"), stamp_ns)
    reading = MoteReading(
        mote="m1", place=None, quantity="q", value=1.0, voltage_v=3.0, rssi_dbm=-70.0, via="r1",
        measured_ns=to_ns(now_s + ahead_s - 40.0),
    )  # fmt: skip
    wire.publisher(MOTE_READING, mote="m1").put(reading, stamp_ns)
    wire.publisher(ROBOT_EVENT, robot="r1", plugin="p", event="e").put(
        PluginEvent(robot="r1", plugin="p", event="e"), stamp_ns
    )
    task = Task(id="t1", kind="visit", place=Point2D(0.0, 0.0), deadline_ns=to_ns(now_s + ahead_s + 90.0))
    wire.publisher(TASK_EVENT).put(TaskEvent(task=task, state=TaskState.QUEUED), stamp_ns)
    found = {received.topic.name: received.message for received in inbox.drain()}
    state, read, event, told = (found[topic.name] for topic in (ROBOT_STATE, MOTE_READING, ROBOT_EVENT, TASK_EVENT))
    assert state.stamp_ns == stamp_ns  # decisions count from its arrival
    assert (read.stamp_ns, read.measured_ns) == (own_ns(0.0), own_ns(40.0))
    assert event.stamp_ns == own_ns(0.0)
    assert (told.stamp_ns, told.task.deadline_ns) == (own_ns(0.0), own_ns(-90.0))
    assert refusals(wire) == []


def test_a_reply_that_names_another_robot_than_was_asked_is_refused(wire):
    wire.answer(ROBOT_MAP_WHOLE, lambda _: map_of("r2"))
    assert wire.ask(ROBOT_MAP_WHOLE, robot="r2").robot == "r2"
    with pytest.raises(CallError, match="a bad reply: its key says robot r1, its payload r2"):
        wire.ask(ROBOT_MAP_WHOLE, robot="r1")
    inbox = Inbox()
    for robot in ("r1", "r2"):
        wire.ask_into(inbox, ROBOT_MAP_WHOLE, ROBOT_MAP, robot=robot)
    assert [received.names["robot"] for received in inbox.drain()] == ["r2"]


def test_refusals_are_logged_at_most_once_a_minute_and_all_of_them_counted(clock, caplog):
    caplog.set_level(logging.WARNING, LOGGER)
    found = Refusals(clock)
    for second in range(120):
        clock.advance_to(to_ns(second))
        found.record("robot_state", "robot/r1/state", RefusalCode.MALFORMED, "a pose\x1b[31m")
        found.record("halt", "halt", RefusalCode.TOO_LARGE, "2 MB")
    assert found.total == 240
    assert len(caplog.records) == 2
    assert "60 of robot_state (robot/r1/state), malformed: a pose\\x1b[31m" in caplog.records[1].message
    assert "60 of halt" in caplog.records[1].message


def test_refusals_of_any_number_of_senders_take_no_more_room(clock):
    found = Refusals(clock)
    for number in range(10 * KINDS_MAX):
        found.record("robot_state", f"robot/r{number}/state", RefusalCode.MALFORMED, "")
    assert found.total == 10 * KINDS_MAX
    assert len(found.counts()) <= KINDS_MAX + 1
    assert sum(one.count for one in found.counts()) == found.total


@pytest.mark.sets_aside
def test_a_record_that_cannot_be_handled_is_set_aside_and_the_others_are_handled(clock):
    found = Refusals(clock)
    handled = []

    def handle(record):
        if record == "bad":
            raise OverflowError("too large")
        handled.append(record)

    RecordGuard(found).records(["a", "bad", "b"], handle, str, "task")
    assert handled == ["a", "b"]
    (one,) = found.counts()
    assert (one.topic, one.key, one.code) == ("task", "bad", "failed")
    assert re.fullmatch(r"protocol/test_border.py:\d+ in \w+: OverflowError: too large", one.why)


@pytest.mark.sets_aside
def test_of_a_batch_only_the_message_that_raises_is_set_aside(clock) -> None:
    found, handled = Refusals(clock), set()
    names = ("a", "bad", "b")
    received = [Received(HALT, f"t/{name}", {}, name) for name in names]

    def handle(batch: Sequence[Received]) -> None:
        for one in batch:
            if one.message == "bad":
                raise OverflowError("too large")
            handled.add(one.message)

    RecordGuard(found).batch(received, handle)
    assert handled == {"a", "b"}
    (one,) = found.counts()
    assert (one.topic, one.key, one.code) == ("halt", "t/bad", "failed")


def test_readers_of_one_message_convert_its_times_each_to_their_own_clock() -> None:
    session = open_lockstep_session()
    clocks = (VirtualClock(), VirtualClock(to_ns(20.0)))
    wires = [Endpoint(session, "default", clock, Drive.LOCKSTEP) for clock in clocks]
    inboxes = [Inbox(), Inbox()]
    for wire, inbox in zip(wires, inboxes, strict=True):
        wire.subscribe(inbox, ROBOT_EVENT, robot="r1")
    names = {"robot": "r1", "plugin": "p", "event": "e"}
    wires[1].publisher(ROBOT_EVENT, **names).put(PluginEvent(**names))
    (first,), (second,) = (inbox.drain() for inbox in inboxes)
    assert (first.message.stamp_ns, second.message.stamp_ns) == (0, to_ns(20.0))
    for wire in wires:
        wire.close()
