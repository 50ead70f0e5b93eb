"""Orders of a master for a robot: the rules of acceptance, tasks, cancellation and restarts, without a broker."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from robrain.deploy.vda5050.fleet_process import RobotVehicle, factsheet, read_order
from robrain.deploy.vda5050.messages import BadVehicleMessage, OrderAction, Vehicle, VehicleOrder, Version, read
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.deploy.vda5050.published_schemas import mistakes

ROBOT = RobotState(robot="r1", pose=Pose2D(0.0, 0.0, 0.0))
WAIT = {"actionType": "wait", "actionId": "w", "blockingType": "HARD",
        "actionParameters": [{"key": "duration", "value": 2}]}  # fmt: skip


def vehicle_of(version: Version) -> Vehicle:
    return Vehicle(version, "robrain", "r1", "arena", Pose2D(0.0, 0.0, 0.0))


def node(number: int, released: bool = True, **fields: Any) -> dict[str, Any]:
    position = {"x": float(number), "y": 0.0, "mapId": "arena"}
    return {"nodeId": f"n{number}", "sequenceId": 2 * number, "released": released, "nodePosition": position,
            "actions": [], **fields}  # fmt: skip


NOWHERE = {key: value for key, value in node(1).items() if key != "nodePosition"}


def order(*nodes: dict[str, Any], update: int = 0, order_id: str = "o/1", **edge: Any) -> dict[str, Any]:
    edges = [
        {"edgeId": f"e{after['sequenceId']}", "sequenceId": after["sequenceId"] - 1, "released": after["released"],
         "startNodeId": "", "endNodeId": "", "actions": [], **edge}
        for after in nodes[1:]
    ]  # fmt: skip
    return {"headerId": 1, "timestamp": "2026-01-01T00:00:00Z", "version": "2.1.0", "manufacturer": "robrain",
            "serialNumber": "r1", "orderId": order_id, "orderUpdateId": update, "nodes": list(nodes),
            "edges": edges}  # fmt: skip


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


class Desk:
    """A robot as a vehicle; its order is in a file of the current folder."""

    def __init__(self, version: Version = Version.V3_0) -> None:
        link: Any = SimpleNamespace(vehicle=vehicle_of(version))
        none: Any = None
        self.file = Path(f"{version}.json")
        self.orders = RobotVehicle(link, self.file, ROBOT, none, none, none)

    def send(self, message: dict[str, Any]) -> bool:
        """Whether it changed the order."""
        before = self.orders.kept
        payload = msgspec.json.encode(message)
        sent = read("order", payload)
        assert isinstance(sent, VehicleOrder)
        self.orders.handle_order(sent, payload)
        assert before is self.orders.kept or read_order(self.file) == self.orders.kept
        return before is not self.orders.kept

    def end(self, state: TaskState = TaskState.DONE) -> None:
        one = next(one for one in self.orders.tasks.values() if not one.has_ended)
        self.orders.record(one.task.id, state, "why")

    @property
    def tasks(self) -> list[Task]:
        return [one.task for one in self.orders.tasks.values()]

    @property
    def errors(self) -> list[tuple[str, str]]:
        return [(error.error_type, error.error_level) for error in self.orders.errors()]

    @property
    def remaining(self) -> list[str]:
        return [one.node_id for one in self.orders.remaining[0]]


def test_each_released_node_becomes_a_task_after_the_one_before() -> None:
    desk = Desk()
    assert desk.send(order(node(0), node(1), node(2), node(3, False)))
    first, second = desk.tasks
    assert (first.place.x_m, first.after, first.needs) == (1.0, (), ("r1",))
    assert (second.place.x_m, second.after) == (2.0, (first.id,))
    assert desk.remaining == ["n1", "n2", "n3"]
    desk.end()
    assert desk.remaining == ["n2", "n3"]
    desk.end()
    assert desk.remaining == ["n3"]
    assert not desk.orders.is_idle


def test_an_update_replaces_the_horizon_and_continues_the_base() -> None:
    desk = Desk()
    desk.send(order(node(0), node(1), node(2, False)))
    before = desk.tasks
    desk.end()
    assert desk.send(order(node(1), node(5, sequenceId=4), update=1))
    assert desk.remaining == ["n5"]
    assert desk.tasks[:1] == before
    desk.end()
    assert desk.orders.is_idle
    assert desk.send(order(node(0), order_id="o/2"))


def test_a_restarted_gateway_makes_the_same_tasks() -> None:
    desk = Desk()
    desk.send(order(node(0), node(1), node(2)))
    again = Desk()
    assert again.tasks == desk.tasks
    assert again.orders.task_to_ask(is_due=False) == desk.tasks[0]
    assert not again.send(order(node(0), node(1), node(2)))
    assert again.errors == []


BASE = (node(0), node(1))
REJECTED = [
    ("VALIDATION_FAILURE", "validationError", order(node(0), NOWHERE, order_id="x")),
    ("VALIDATION_FAILURE", "validationError", order(node(0), node(2), order_id="x")),
    ("VALIDATION_FAILURE", "validationError", order(node(0), node(1, False), node(2), order_id="x")),
    ("VALIDATION_FAILURE", "validationError", {**order(node(0), node(1), order_id="x"), "edges": []}),
    ("UNKNOWN_MAP_ID", "orderError", order(node(0), node(1, nodePosition={"x": 0, "y": 0, "mapId": "m"}))),
    ("UNSUPPORTED_PARAMETER", "orderError", order(*BASE, order_id="x", maxSpeed=1.0)),
    ("INVALID_ORDER_ACTION", "orderError", order(node(0), node(1, actions=[{**WAIT, "actionType": "pick"}]))),
    ("INVALID_ORDER_ACTION", "orderError", order(*BASE, actions=[WAIT])),
    ("OTHER_ORDER_ACTIVE", "orderUpdateError", order(*BASE, order_id="x")),
    ("SAME_ORDER_UPDATE_ID", None, order(node(1), node(2), update=1)),
    ("OUTDATED_ORDER_UPDATE", "orderUpdateError", order(*BASE, update=0)),
    ("VALIDATION_FAILURE", "orderUpdateError", order(node(0), node(1), update=2)),
]


@pytest.mark.parametrize(("new_type", "old_type", "message"), REJECTED)
def test_an_order_is_rejected_with_the_error_type_of_the_standard(
    new_type: str, old_type: str | None, message: dict[str, Any]
) -> None:
    for version, expected in ((Version.V3_0, new_type), (Version.V2_1, old_type)):
        desk = Desk(version)
        desk.send(order(*BASE))
        assert desk.send(order(node(1), node(2), node(3), update=1))
        assert not desk.send(message)
        assert [kind for kind, _ in desk.errors] == ([] if expected is None else [expected])
        assert desk.orders.kept.order_update_id == 1


@pytest.mark.parametrize("junk", [b"1e999", b'"\xff"'])
def test_an_unknown_field_that_is_no_json_ends_no_process(junk: bytes) -> None:
    for message in (order(*BASE, junk=0), {**order(*BASE), "junk": 0}):
        payload = msgspec.json.encode(message).replace(b'"junk":0', b'"junk":' + junk)
        try:
            sent = read("order", payload)
        except BadVehicleMessage:
            continue
        assert isinstance(sent, VehicleOrder)
        desk = Desk()
        desk.orders.handle_order(sent, payload)
        assert desk.orders.kept.nodes


def test_a_start_out_of_range_is_rejected() -> None:
    desk = Desk()
    assert not desk.send(order(node(0, nodePosition={"x": 3.0, "y": 0.0, "mapId": "arena"})))
    assert desk.errors == [("START_NODE_OUT_OF_RANGE", "WARNING")]
    near = {"x": 3.0, "y": 0.0, "mapId": "arena", "allowedDeviationXY": {"a": 4.0, "b": 4.0, "theta": 0.0}}
    assert desk.send(order(node(0, nodePosition=near)))
    assert desk.errors == []


def test_a_cancelled_order_ends_with_its_tasks_and_takes_no_update() -> None:
    desk = Desk()
    desk.send(order(node(0), node(1, actions=[WAIT]), node(2, False)))
    desk.orders.cancel(OrderAction("cancelOrder", "c1", "NONE"))
    assert read_order(desk.file).cancelled_by == ["c1"]
    assert desk.orders.instant["c1"].action_status == "RUNNING"
    desk.end(TaskState.CANCELLED)
    assert [one.action_status for one in desk.orders.instant_states()] == ["FINISHED"]
    assert desk.orders.is_idle
    assert [one.action_status for one in desk.orders.action_states(None)] == ["FAILED"]
    assert not desk.send(order(node(1), node(2), update=1))
    assert desk.errors == [("ORDER_UPDATE_FOLLOWING_CANCEL", "WARNING")]


def test_there_is_nothing_to_cancel_without_an_order() -> None:
    desk = Desk()
    desk.orders.cancel(OrderAction("cancelOrder", "c1", "NONE"))
    assert desk.orders.instant["c1"].action_status == "FAILED"
    assert desk.errors == [("NO_ORDER_TO_CANCEL", "WARNING")]


def test_a_wait_is_the_time_at_the_node() -> None:
    desk = Desk()
    assert desk.send(order(node(0), node(1, actions=[WAIT])))
    (task,) = desk.tasks
    assert task.service_s == 2.0
    desk.orders.record(task.id, TaskState.RUNNING, "")
    states = [[one.action_status for one in desk.orders.action_states(Pose2D(x_m, 0.0, 0.0))] for x_m in (0.0, 1.0)]
    assert states == [["WAITING"], ["RUNNING"]]
    desk.end()
    assert [one.action_status for one in desk.orders.action_states(None)] == ["FINISHED"]


@pytest.mark.parametrize(("version", "level"), [(Version.V2_1, "FATAL"), (Version.V3_0, "CRITICAL")])
def test_a_node_whose_task_fails_is_reported_and_the_order_stays(version: Version, level: str) -> None:
    desk = Desk(version)
    desk.send(order(*BASE))
    desk.end(TaskState.FAILED)
    assert [error_level for _, error_level in desk.errors] == [level]
    assert desk.remaining == ["n1"]
    assert not desk.send(order(node(0), order_id="x"))


@pytest.mark.parametrize("version", list(Version))
def test_a_factsheet_is_valid(version: Version) -> None:
    message = msgspec.json.decode(vehicle_of(version).payload(factsheet(vehicle_of(version), ROBOT), 0, 0))
    assert not mistakes(version, "factsheet", message)
