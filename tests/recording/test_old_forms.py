"""Older recordings: fields, tasks and reasons get today's form where messages are read."""

from pathlib import Path

import msgspec
import pytest
from mcap.records import Channel, Message

from robrain.protocol.messages.maps.map_messages import Closure
from robrain.protocol.messages.motes.mote_messages import GatewayCount, MoteReading
from robrain.protocol.messages.robots.robot_messages import RadioLink, RobotState, TaskStatus
from robrain.protocol.messages.robots.witness_messages import Lead
from robrain.protocol.messages.tasks.consensus_messages import TaskHeldBy, TeamBallot
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT
from robrain.protocol.messages.tasks.plan_messages import PlanningStatus
from robrain.protocol.messages.tasks.task_messages import RobotVerdict
from robrain.protocol.messages.team.arena_messages import ArenaPreparation, RadioTruth
from robrain.protocol.messages.team.standing_messages import JournalAlarm, KnownRobot, LeadReply
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE
from robrain.protocol.model.ballot import Ballot
from robrain.protocol.model.energy_model import EnergyModel
from robrain.protocol.model.tasks.old_form import RENAMED, upgraded, upgraded_json
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.reasons import MinorityReached, NearestOut, NoState, PlainReason
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


def test_code_that_is_no_text_is_left_to_the_reader_that_refuses_it() -> None:
    for code in ([1], {"a": 1}, 3, None):
        assert upgraded({"reason": {"code": code}}) == {"reason": {"code": code}}


def test_old_reasons_are_read_with_their_kind_sentence_and_values() -> None:
    gave_up = b'{"code":"gave_up","because":{"code":"nearest_out","robot":"r1","because":{"code":"crowded"}}}'
    task = (GOLDEN / "tasks" / "visit.json").read_bytes()
    payload = b'{"task":' + task + b',"state":"failed","why":"nobody can do it","reason":' + gave_up + b"}"
    event = TASK_EVENT.payloads.read(
        recorded_message(channel(TASK_EVENT.key("default")), Message(1, 8, payload, 7, 3)).payload
    )
    assert event.reason == PlainReason("nobody can do it", "gave_up")
    idle = b'{"name":"r1","up":true,"age_s":0.1,"why":"idle","idle":{"code":"no_way","frontiers":2,"needed_m":0.5}'
    idle += b',"out":{"code":"not_heard"}}'
    payload = b'{"robots":[' + idle + b'],"refused":[{"topic":"t","key":"k","code":"failed","count":1,"why":""}]}'
    found = recorded_message(channel(COORDINATOR_STATE.key("default")), Message(1, 8, payload, 7, 3)).payload
    state = COORDINATOR_STATE.payloads.read(found)
    assert state.robots[0].idle == PlainReason("idle", "no_way", {"frontiers": 2, "needed_m": 0.5})
    assert state.robots[0].out == NoState()
    assert state.refused[0].code == "failed"
    nearest = {"robot": "r1", "because": {"code": "crowded"}, "code": "nearest_out"}
    decoded = msgspec.json.decode(upgraded_json(b'{"reason":' + msgspec.json.encode(nearest) + b"}"))["reason"]
    assert msgspec.convert(decoded, NearestOut) == NearestOut("r1", PlainReason("crowded", "crowded"))


POSE = '{"x_m":1,"y_m":2,"yaw_rad":0}'
PLACE = '{"x_m":1,"y_m":2}'
SUMMARY = '{"name":"r1","up":true,"age_s":0}'
FLOOR = '{"robot":"arena","resolution_m":0.1,"origin_x_m":0,"origin_y_m":0,"width":1,"height":1}'
RENAMED_IN = {
    Closure: f'"submap":1,"at":{POSE},"mate":"r2","mate_submap":7,"at_mate":{POSE},"information":[1,0,0,1,0,1]',
    MoteReading: '"mote":"m","place":null,"quantity":"q","value":1,"voltage_v":3,"rssi_dbm":-7,"via":"r1","taken_ns":5',
    GatewayCount: '"name":"g","readings":1,"waiting":0,"dropped":0,"heard_ns":5',
    RadioLink: '"peer":"r2","rssi_dbm":-70,"heard_ns":5',
    TaskStatus: '"id":"t","epoch":1,"state":"running","left_s":2.5',
    RobotState: '"robot":"r1","goes_on_s":120,"changes_heard":41,"left_out":3',
    Lead: '"election":3,"journal":"a","heard":2',
    TaskHeldBy: '"id":"t","robot":"r9","left_s":41.5',
    TeamBallot: '"robot":"r1","ballot":{"robot":"r1","number":1},"hears_coordinator":true,"hears":[]',
    PlanningStatus: '"objective":"energy","method":"m","left_out":1,"took_s":0.25',
    RobotVerdict: '"robot":"r1","why_not":"is halted"',
    RadioTruth: f'"party":"r1","place":{PLACE},"hears":["coordinator"]',
    ArenaPreparation: f'"parts_ready":1,"parts":2,"left_s":12.5,"floor":{FLOOR},"truth":{{"sim_time_s":0,"robots":[]}}',
    JournalAlarm: '"rule":"warm","source":"m","taken_ns":5,"fired_ns":6',
    KnownRobot: f'"heard_ns":5,"goes_on":true,"summary":{SUMMARY}',
    LeadReply: '"left_out":["r2"]',
    Ballot: '"robot":"r1","number":7,"heard":[{"robot":"r2","number":6}]',
    EnergyModel: (
        '"coefficients":[8,0.5,7.5,1.25,8],"covariance":[0,0,0,0,0,0,0,0,0,0,0,0,0,0,0],"residual_w2_s":4,'
        '"drift_w2_per_s":0,"relative_sd":0,"way_ratio":1.02,"pace_m_s":0.5,"turn_rate_rad_s":1,"packet_j":0,'
        '"usable_j":9,"power_w":12,"usual_power_w":11'
    ),
    MinorityReached: '"code":"minority_heard","heard":1,"robots":4',
}
"""Fields of messages that had another name, as an older recording has them."""


@pytest.mark.parametrize(("kind", "fields"), RENAMED_IN.items(), ids=lambda given: getattr(given, "__name__", ""))
def test_a_field_with_its_former_name_is_read(kind: type, fields: str) -> None:
    old = f"{{{fields}}}".encode()
    written = {RENAMED[name]: value for name, value in msgspec.json.decode(old).items() if name in RENAMED}
    read = msgspec.json.decode(msgspec.json.encode(msgspec.json.decode(upgraded_json(old), type=kind)))
    assert written
    assert {name: read[name] for name in written} == written


def test_free_contents_keep_their_names() -> None:
    payload = b'{"left_s":1.0,"result":{"heard":3},"task":{"id":"t","kind":"own","parameters":{"way_m":1.0}}}'
    assert upgraded_json(payload) == payload.replace(b"left_s", b"remaining_s")
