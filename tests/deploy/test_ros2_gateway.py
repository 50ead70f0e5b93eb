"""The gateway to ROS 2: what it shows of a team, and the orders that it passes on."""

import json
import math
import threading
import zlib
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest

from robrain.client.asker import Then
from robrain.client.halting import HaltReport
from robrain.deploy.ros2.gateway_process import TEXT_MAX, Gateway, OrderOutcome, TeamOrders, halt, submit
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.errors import NobodyThere
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP, MapPatch
from robrain.protocol.messages.robots import robot_messages
from robrain.protocol.messages.robots.robot_messages import PlannedPath, RobotState
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT, TaskEvent
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.messages.team.arena_messages import ARENA_SCAN, Scan
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.map_frame import MapFrame
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.ros2.message_types import (
    MessageType,
    Nothing,
    ServiceType,
    SubmitTaskResponse,
    TaskText,
    TriggerResponse,
)
from robrain.protocol.ros2.qos import LATCHED, RELIABLE, SENSOR_DATA, Qos
from robrain.protocol.ros2.ros_port import ReceivedMessage
from robrain.protocol.wire.endpoint import Endpoint

GEOMETRY = GridGeometry(width=8, height=6, resolution_m=0.05, origin_x_m=-1.0, origin_y_m=-2.0)


def wall_patch(row: int, column: int) -> MapPatch:
    """An occupied cell, and a free one to the right of it, seen by r1."""
    return MapPatch(
        robot="r1",
        **msgspec.structs.asdict(GEOMETRY),
        row=row,
        column=column,
        rows=1,
        columns=2,
        observed_ms=1000,
        cells=zlib.compress(np.array([100, 0], np.int8).tobytes()),
    )


class KeptWriter:
    def __init__(self, kind: MessageType[Any], qos: Qos) -> None:
        self.kind, self.qos = kind, qos
        self.messages: list[Any] = []

    def publish(self, message: Any) -> None:
        self.messages.append(self.kind.decode(self.kind.encode(message)))

    def close(self) -> None: ...


class KeptRequest:
    def __init__(self, request: Any) -> None:
        self.request = request
        self.response: Any = None

    def reply(self, response: Any) -> None:
        self.response = response

    def refuse(self, why: str) -> None: ...


class KeptServer:
    dropped = refused = 0

    def __init__(self) -> None:
        self.asked: list[KeptRequest] = []

    def ask(self, request: Any) -> KeptRequest:
        self.asked.append(KeptRequest(request))
        return self.asked[-1]

    def requests(self) -> list[KeptRequest]:
        asked, self.asked = self.asked, []
        return asked

    def close(self) -> None: ...


class KeptReader:
    dropped = refused = 0

    def __init__(self) -> None:
        self.waiting: list[Any] = []

    def read(self) -> list[ReceivedMessage[Any]]:
        waiting, self.waiting = self.waiting, []
        return [ReceivedMessage(message, 0, bytes(16), 1) for message in waiting]

    def close(self) -> None: ...


class KeptPort:
    """A port that goes nowhere: messages are encoded, decoded and kept."""

    def __init__(self) -> None:
        self.topics: dict[str, KeptWriter] = {}
        self.services: dict[str, KeptServer] = {}
        self.heard: dict[str, KeptReader] = {}

    def advertise(self, topic: str, kind: MessageType[Any], qos: Qos = RELIABLE) -> KeptWriter:
        return self.topics.setdefault(topic, KeptWriter(kind, qos))

    def subscribe(self, topic: str, kind: MessageType[Any], qos: Qos = RELIABLE) -> "KeptReader":
        return self.heard.setdefault(topic, KeptReader())

    def serve(self, service: str, kind: ServiceType[Any, Any]) -> KeptServer:
        return self.services.setdefault(service, KeptServer())

    def last(self, topic: str) -> Any:
        return self.topics[topic].messages[-1]

    def close(self) -> None: ...


class KeptOrders(TeamOrders):
    """Orders that end when the test says so."""

    def __init__(self) -> None:
        self.submitted: list[tuple[Any, Then[OrderOutcome]]] = []
        self.halts: list[Then[OrderOutcome]] = []

    def submit(self, values: Any, then: Then[OrderOutcome]) -> None:
        self.submitted.append((values, then))

    def halt(self, then: Then[OrderOutcome]) -> None:
        self.halts.append(then)

    def deliver(self) -> None: ...


class Bench(NamedTuple):
    clock: VirtualClock
    wire: Endpoint
    port: KeptPort
    orders: KeptOrders
    gateway: Gateway

    def say(self, topic: Any, message: Any, **names: str) -> None:
        self.wire.publisher(topic, **names).put(message)

    def step(self) -> None:
        self.clock.advance_to(self.clock.now_ns() + to_ns(1.0))
        self.gateway.step()

    def state(self, robot: str = "r1", **values: Any) -> None:
        self.say(robot_messages.ROBOT_STATE, RobotState(robot=robot, **values), robot=robot)
        self.step()


@pytest.fixture
def bench(wire: Endpoint) -> Bench:
    port, orders = KeptPort(), KeptOrders()
    wire.clock.advance_to(to_ns(100.5))
    return Bench(wire.clock, wire, port, orders, Gateway(wire, port, orders))


def test_a_robots_place_is_a_pose_and_a_transform(bench):
    bench.state(pose=Pose2D(1.0, 2.0, math.pi / 2))
    pose, (transform,) = bench.port.last("r1/pose"), bench.port.last("/tf").transforms
    assert (pose.header.frame_id, pose.header.stamp.sec, pose.header.stamp.nanosec) == ("map", 100, 500_000_000)
    assert (pose.pose.position.x, pose.pose.position.y) == (1.0, 2.0)
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "r1/base_link")
    assert transform.transform.rotation.z == pytest.approx(math.sqrt(0.5))


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"pose": Pose2D(1, 2, 3), "frame": MapFrame(1, "r1")},
        {"pose": Pose2D(1, 2, 3), "lost": "the scan does not fit the map"},
    ],
)
def test_a_robot_that_does_not_know_its_place_has_none_in_ros(bench, values):
    bench.state(**values)
    assert "r1/pose" not in bench.port.topics
    assert "/tf" not in bench.port.topics


def test_a_robot_that_is_lost_is_shown_where_it_was_last_sure_until_it_knows_its_place_again(bench):
    bench.state(pose=Pose2D(1.0, 0.0, 0.0))
    bench.state(pose=Pose2D(5.0, 0.0, 0.0), lost="the scan does not fit the map")
    for shown in (bench.port.topics["r1/pose"].messages, bench.port.topics["/tf"].messages):
        assert len(shown) == 1
    assert "r1 lost" in {each.text for each in bench.port.last("markers").markers}
    bench.state(pose=Pose2D(2.0, 0.0, 0.0))
    assert bench.port.last("r1/pose").pose.position.x == 2.0
    assert bench.port.last("/tf").transforms[0].transform.translation.x == 2.0


def test_a_scan_is_in_its_robots_frame_and_no_return_is_infinite(bench):
    scan = Scan(robot="r1", angle_min_rad=-1.0, angle_increment_rad=0.5, range_max_m=8.0, ranges_mm=[1500, 0, 250])
    bench.say(ARENA_SCAN, scan, robot="r1")
    bench.step()
    shown = bench.port.last("r1/scan")
    assert (shown.header.frame_id, shown.angle_max, shown.ranges.tolist()) == (
        "r1/base_link",
        0.0,
        [1.5, math.inf, 0.25],
    )
    assert bench.port.topics["r1/scan"].qos == SENSOR_DATA


def test_a_path_is_latched_and_looks_ahead(bench):
    planned = PlannedPath(robot="r1", points=[Point2D(0, 0), Point2D(0, 1), Point2D(1, 1)])
    bench.say(robot_messages.ROBOT_PATH, planned, robot="r1")
    bench.step()
    poses = bench.port.last("r1/path").poses
    yaws_rad = [2 * math.atan2(each.pose.orientation.z, each.pose.orientation.w) for each in poses]
    assert yaws_rad == pytest.approx([math.pi / 2, 0.0, 0.0])
    assert bench.port.topics["r1/path"].qos == LATCHED


def test_the_map_is_latched_and_that_of_map_server(bench):
    bench.say(ROBOT_MAP, wall_patch(row=2, column=3), robot="r1")
    bench.step()
    shown = bench.port.last("map")
    assert (shown.info.width, shown.info.height, shown.info.resolution) == (8, 6, pytest.approx(0.05))
    assert (shown.info.origin.position.x, shown.info.origin.position.y) == (-1.0, -2.0)
    cells = shown.data.reshape(6, 8)
    assert (cells[2, 3], cells[2, 4], cells[0, 0]) == (100, 0, -1)
    assert bench.port.topics["map"].qos == LATCHED
    bench.step()
    assert len(bench.port.topics["map"].messages) == 1  # nothing new


def test_robots_and_open_tasks_are_marked_and_ended_tasks_are_not(bench):
    task = Task(id="v", kind="visit", place=Point2D(3.0, 4.0))
    bench.state(pose=Pose2D(0, 0, 0), halted=True)
    bench.say(TASK_EVENT, TaskEvent(task=task, state=TaskState.QUEUED))
    bench.step()
    shown = bench.port.last("markers").markers
    assert shown[0].action == 3  # all that was drawn goes first
    assert {each.text for each in shown if each.text} == {"r1 halted", "visit v queued"}
    assert [(each.pose.position.x, each.pose.position.y) for each in shown if each.ns == "tasks"] == [(3.0, 4.0)]
    bench.say(TASK_EVENT, TaskEvent(task=task, state=TaskState.DONE))
    bench.step()
    assert [each for each in bench.port.last("markers").markers if each.ns == "tasks"] == []
    told = [json.loads(each.data)["state"] for each in bench.port.topics["task_events"].messages]
    assert told == ["queued", "done"]


def test_a_name_that_ros_does_not_have_is_changed_and_two_never_share_one(bench):
    for robot in ("1-a", "1.a", "1_a"):
        bench.state(robot, pose=Pose2D(0, 0, 0))
    assert [topic for topic in bench.port.topics if topic.endswith("/pose")] == ["_1_a/pose"]
    assert bench.gateway.left_out == 2


def test_a_task_is_answered_once_the_team_has_answered(bench):
    asked = bench.port.services["submit_task"].ask(TaskText("{}"))
    bench.step()
    ((text, then),) = bench.orders.submitted
    assert (text, asked.response) == ("{}", None)
    then(OrderOutcome(True, "visit-1"), "")
    assert asked.response == SubmitTaskResponse(True, "visit-1")


def test_a_halt_does_not_wait_for_a_task(bench):
    bench.port.services["submit_task"].ask(TaskText("{}"))
    halt = bench.port.services["halt"].ask(Nothing())
    bench.step()
    bench.orders.halts[0](OrderOutcome(False, "r1: NOT halted: lost"), "")
    assert halt.response == TriggerResponse(False, "r1: NOT halted: lost")


class KeptTeam:
    """A team that does what the test says."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.may_answer = threading.Event()
        self.may_answer.set()
        self.report: HaltReport | Exception = NobodyThere("nobody is there")
        self.is_closed = False

    def submit(self, kind: str, **fields: Any) -> TaskRecord:
        self.may_answer.wait()
        self.asked.append((kind, fields))
        if kind == "dance":
            raise NobodyThere("no robot can dance")
        return TaskRecord(task=Task(id="v", kind=kind, place=Point2D(1, 2)), state=TaskState.QUEUED)

    def halt(self, *, reason: str, by: str) -> HaltReport:
        if isinstance(self.report, Exception):
            raise self.report
        return self.report

    def close(self) -> None:
        self.is_closed = True


def test_a_task_is_submitted_with_its_fields():
    team: Any = KeptTeam()
    answer = submit(team, '{"kind": "visit", "place": [1, 2], "priority": 3}')
    assert (answer.accepted, json.loads(answer.text)["task"]["id"]) == (True, "v")
    ((kind, fields),) = team.asked
    assert (kind, fields["place"], fields["priority"], fields["id"]) == ("visit", (1.0, 2.0), 3.0, None)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "expected a task as JSON"),
        ("{}", "expected a task as JSON"),
        ('{"kind": "visit", "place": [1]}', "expected a task as JSON"),
        ('{"kind": "visit", "colour": "red"}', "expected a task as JSON"),
        ("[" * 100_000, "characters, got 100000"),
        ("[" * (TEXT_MAX - 1), "expected a task as JSON"),
        ('{"kind": "dance"}', "no robot can dance"),
    ],
)
def test_what_is_no_task_is_answered_with_the_reason(text, why):
    answer = submit(KeptTeam(), text)  # type: ignore[arg-type]
    assert (answer.accepted, why in answer.text) == (False, True)


def test_a_halt_says_who_has_not_stopped():
    team: Any = KeptTeam()
    assert halt(team, "ros2") == (False, "nobody is there")
    team.report = HaltReport(halted=True, by="ros2", confirmed=("r1",), unconfirmed={"r2": "lost"})
    assert halt(team, "ros2") == (False, "r1: halted; r2: NOT halted: lost")
    team.report = HaltReport(halted=True, by="ros2", confirmed=("r1",), unconfirmed={})
    assert halt(team, "ros2") == (True, "r1: halted")
