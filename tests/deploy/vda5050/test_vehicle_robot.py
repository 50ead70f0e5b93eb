"""A vehicle as a robot: orders, withdrawals, halts, errors and restarts, under a virtual clock without a broker."""

from typing import Any

import msgspec
import pytest

from robrain.deploy.vda5050.messages import BadVehicleMessage, State, Vehicle, Version, read
from robrain.deploy.vda5050.vehicle_process import VehicleRobot
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.tasks.offer_messages import TaskOffer, TaskWithdrawal
from robrain.protocol.model.geometry import IDENTITY, Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.model.zone import Zone, ZoneKind
from tests.deploy.vda5050.published_schemas import mistakes

VERSIONS = list(Version)
TASK = Task(id="t1", kind="visit", place=Point2D(3.0, 4.0))
ERROR = {"errorType": "motor", "errorLevel": "FATAL", "errorDescription": "too hot"}


class Stage:
    """A vehicle that is idle at (1, 2) of its map."""

    def __init__(self, version: Version = Version.V2_1, T_arena_map: Pose2D = IDENTITY) -> None:
        self.vehicle = Vehicle(version, "acme", "7", "", T_arena_map)
        self.robot = VehicleRobot("v1", self.vehicle, 0.5, 30.0)
        self.now_ns = to_ns(100.0)
        self.fields: dict[str, Any] = {
            "headerId": 1, "timestamp": "2026-01-01T00:00:00Z", "version": version, "manufacturer": "acme",
            "serialNumber": "7", "orderId": "", "orderUpdateId": 0, "lastNodeId": "", "lastNodeSequenceId": 0,
            "nodeStates": [], "edgeStates": [], "driving": False, "operatingMode": "AUTOMATIC", "actionStates": [],
            "errors": [], "safetyState": {"eStop": "NONE", "fieldViolation": False},
            "agvPosition": {"x": 1.0, "y": 2.0, "theta": 0.0, "mapId": "hall", "positionInitialized": True},
            "batteryState": {"batteryCharge": 80.0, "charging": False},
        }  # fmt: skip

    def tell(self, **fields: Any) -> list[tuple[str, dict[str, Any]]]:
        """The vehicle's state changes; a moment later, what the robot sends to it."""
        self.fields |= fields
        state = read("state", msgspec.json.encode(self.fields))
        assert isinstance(state, State)
        self.robot.handle(state, self.now_ns)
        return self.wait(0.02)

    def wait(self, seconds: float) -> list[tuple[str, dict[str, Any]]]:
        self.now_ns += to_ns(seconds)
        sent = self.robot.step(self.now_ns)
        for topic, body in sent:
            message = msgspec.json.decode(self.vehicle.payload(body, 0, self.now_ns))
            assert not mistakes(self.vehicle.version, topic, message)
        return [(topic, msgspec.to_builtins(body)) for topic, body in sent]

    def offer(self, epoch: int = 1, task: Task = TASK) -> bool:
        return self.robot.offer(TaskOffer(task=task, epoch=epoch, lease_s=1.5), self.now_ns).accepted

    def drive(self, order: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
        """The vehicle accepts an order and sets out."""
        nodes = [{"nodeId": n["nodeId"], "sequenceId": n["sequenceId"], "released": True} for n in order["nodes"][1:]]
        return self.tell(orderId=order["orderId"], nodeStates=nodes, lastNodeId="node-0", driving=True)

    def arrive(self, order: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
        last = order["nodes"][-1]
        return self.tell(orderId=order["orderId"], nodeStates=[], lastNodeId=last["nodeId"], driving=False)

    @property
    def status(self) -> TaskState | None:
        task = self.robot.robot_state().task
        return None if task is None else task.state


def begun(version: Version = Version.V2_1, task: Task = TASK) -> tuple[Stage, dict[str, Any]]:
    """A vehicle that drives, and its order."""
    stage = Stage(version)
    stage.tell()
    assert stage.offer(task=task)
    ((topic, order),) = stage.wait(0.02)
    assert topic == "order"
    stage.drive(order)
    return stage, order


@pytest.mark.parametrize("version", VERSIONS)
def test_a_visit_becomes_one_order_and_ends_at_its_last_node(version: Version) -> None:
    stage, order = begun(version)
    places = [(node["nodePosition"]["x"], node["nodePosition"]["y"]) for node in order["nodes"]]
    assert places == [(1.0, 2.0), (3.0, 4.0)]
    assert stage.status is TaskState.RUNNING
    assert stage.robot.path == [Point2D(1.0, 2.0), Point2D(3.0, 4.0)]
    assert stage.arrive(order) == []
    assert stage.status is TaskState.DONE
    assert stage.robot.path == []


def test_an_order_that_is_not_confirmed_is_sent_again_with_the_same_id() -> None:
    stage = Stage()
    stage.tell()
    stage.offer()
    first = stage.wait(0.02)
    assert stage.wait(0.5) == []
    assert stage.wait(0.6) == first


def test_the_place_is_moved_into_the_vehicles_map() -> None:
    stage = Stage(T_arena_map=Pose2D(10.0, 0.0, 0.0))
    stage.tell()
    pose = stage.robot.robot_state().pose
    assert pose is not None
    assert pose.x_m == pytest.approx(11.0)
    stage.offer()
    ((_, order),) = stage.wait(0.02)
    assert order["nodes"][-1]["nodePosition"]["x"] == pytest.approx(-7.0)


def test_a_restarted_process_learns_the_task_from_the_vehicle() -> None:
    before, order = begun(task=Task(id="t1", kind="visit", place=Point2D(3.0, 4.0), service_s=2.0))
    stage = Stage()
    stage.fields = before.fields
    assert stage.tell() == []
    task = stage.robot.robot_state().task
    assert task is not None
    assert (task.id, task.epoch, task.state) == ("t1", 1, TaskState.RUNNING)
    stage.arrive(order)
    assert stage.status is TaskState.RUNNING
    stage.wait(2.1)
    assert stage.status is TaskState.DONE
    assert not stage.offer(epoch=0)


def test_a_task_that_the_vehicle_has_done_is_not_done_again() -> None:
    before, order = begun()
    before.arrive(order)
    stage = Stage()
    stage.fields = before.fields
    stage.tell()
    assert stage.offer(epoch=2)
    assert stage.wait(0.02) == []
    task = stage.robot.robot_state().task
    assert task is not None
    assert (task.epoch, task.state) == (2, TaskState.DONE)


def test_a_task_that_is_offered_again_while_its_order_is_on_its_way_is_not_done_twice() -> None:
    stage = Stage()
    stage.tell()
    stage.offer(epoch=1)
    ((_, order),) = stage.wait(0.02)
    assert stage.offer(epoch=2)
    assert stage.wait(0.02) == []
    assert stage.drive(order) == []
    assert stage.arrive(order) == []
    task = stage.robot.robot_state().task
    assert task is not None
    assert (task.epoch, task.state) == (2, TaskState.DONE)


def test_the_next_order_waits_for_one_that_may_still_arrive() -> None:
    stage = Stage()
    stage.tell()
    stage.offer()
    ((_, order),) = stage.wait(0.02)
    assert stage.offer(2, Task(id="t2", kind="visit", place=Point2D(0.0, 0.0)))
    assert stage.wait(0.02) == []
    assert actions(stage.drive(order)) == ["cancelOrder"]
    stage.tell(nodeStates=[], driving=False)
    ((topic, second),) = stage.wait(0.02) or stage.wait(1.0)
    assert (topic, second["orderId"]) == ("order", "robrain:t2:2")


def actions(sent: list[tuple[str, dict[str, Any]]]) -> list[str]:
    return [action["actionType"] for topic, body in sent if topic == "instantActions" for action in body["actions"]]


def test_a_withdrawn_task_runs_until_the_vehicle_has_dropped_its_order() -> None:
    stage, _ = begun()
    stage.robot.withdraw(TaskWithdrawal(id="t1", epoch=1))
    assert actions(stage.wait(0.02)) == ["cancelOrder"]
    assert stage.status is TaskState.RUNNING
    assert actions(stage.wait(1.0)) == ["cancelOrder"]
    stage.tell(nodeStates=[])
    assert stage.status is TaskState.CANCELLED


def test_a_task_that_is_completed_before_it_is_cancelled_is_done() -> None:
    stage, order = begun()
    stage.robot.withdraw(TaskWithdrawal(id="t1", epoch=1))
    stage.wait(0.02)
    stage.arrive(order)
    assert stage.status is TaskState.DONE


def test_the_order_is_cancelled_when_the_lease_ends() -> None:
    stage, _ = begun()
    assert stage.wait(29.0) == []
    assert actions(stage.wait(1.1)) == ["cancelOrder"]


def test_a_halt_is_confirmed_by_the_vehicles_state() -> None:
    stage, _ = begun()
    stage.robot.halt("operator:ann", "a person")
    assert actions(stage.wait(0.02)) == ["startPause", "cancelOrder"]
    assert not stage.robot.robot_state().has_stopped
    stage.tell(paused=True, driving=False, nodeStates=[])
    assert stage.robot.robot_state().has_stopped
    assert not stage.offer(epoch=2)
    assert stage.robot.resume("operator:ann", stage.now_ns) == ""
    assert actions(stage.wait(0.02)) == ["stopPause"]
    stage.tell(paused=False)
    assert stage.offer(epoch=2)


def test_a_vehicle_that_is_paused_by_itself_is_halted_until_an_operator_resumes() -> None:
    stage = Stage()
    assert stage.tell(paused=True) == []
    assert stage.robot.robot_state().halted_by == ["vehicle"]
    assert stage.robot.resume("ann", stage.now_ns) != ""
    assert stage.robot.resume("operator", stage.now_ns) == ""
    assert actions(stage.wait(0.02)) == ["stopPause"]


def test_a_fatal_error_fails_the_task_with_its_reason() -> None:
    stage, _ = begun()
    assert actions(stage.tell(errors=[ERROR])) == ["cancelOrder"]
    task = stage.robot.robot_state().task
    assert task is not None
    assert (task.state, task.why) == (TaskState.FAILED, "motor: too hot")
    assert stage.robot.robot_state().faulted[0].why == "motor: too hot"


def test_a_rejected_order_fails_the_task() -> None:
    stage = Stage()
    stage.tell()
    stage.offer()
    ((_, order),) = stage.wait(0.02)
    reference = {"referenceKey": "orderId", "referenceValue": order["orderId"]}
    stage.tell(errors=[{"errorType": "noRoute", "errorLevel": "WARNING", "errorReferences": [reference]}])
    assert stage.status is TaskState.FAILED


def test_an_order_of_another_master_is_left_alone() -> None:
    stage = Stage()
    node = {"nodeId": "x", "sequenceId": 2, "released": True}
    stage.tell(orderId="theirs", nodeStates=[node])
    stage.offer()
    assert stage.wait(0.02) == []
    assert stage.status is TaskState.CANCELLED


def test_a_patrol_becomes_an_order_of_all_places() -> None:
    stops = {"stops": [{"x_m": 5.0, "y_m": 4.0}], "rounds": 2}
    _, order = begun(task=Task(id="p", kind="patrol", place=Point2D(3.0, 4.0), parameters=stops))
    assert [node["nodePosition"]["x"] for node in order["nodes"]] == [1.0, 3.0, 5.0, 3.0, 5.0, 3.0]


def test_zones_are_sent_once_and_enabled() -> None:
    stage = Stage(Version.V3_0)
    corners = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))
    stage.robot.zones = [
        Zone(name="z", kind=ZoneKind.KEEP_OUT, corners_m=corners),
        Zone(name="slow", kind=ZoneKind.SPEED_LIMIT, corners_m=corners, speed_m_s=0.3),
        Zone(name="p", kind=ZoneKind.PENALTY, corners_m=corners, cost_m=1.0),
        Zone(name="desk", kind=ZoneKind.PLACE, corners_m=corners),
    ]
    ((topic, body),) = stage.tell(zoneSets=[])
    assert topic == "zoneSet"
    assert [zone["zoneType"] for zone in body["zoneSet"]["zones"]] == ["BLOCKED", "SPEED_LIMIT", "PENALTY"]
    there = {"zoneSetId": body["zoneSet"]["zoneSetId"], "mapId": "hall", "zoneSetStatus": "DISABLED"}
    assert actions(stage.tell(zoneSets=[there])) == ["enableZoneSet"]
    assert stage.tell(zoneSets=[{**there, "zoneSetStatus": "ENABLED"}]) == []


@pytest.mark.parametrize("change", [{"orderId": 5}, {"nodeStates": [{"sequenceId": -1}]}, {"operatingMode": "ASLEEP"}])
def test_a_bad_state_is_refused_with_topic_and_key(change: dict[str, Any]) -> None:
    fields = {**Stage().fields, **change}
    with pytest.raises(BadVehicleMessage, match=rf"uagv/v2/acme/7/state: .*\$\.{next(iter(change))}"):
        read("uagv/v2/acme/7/state", msgspec.json.encode(fields))
