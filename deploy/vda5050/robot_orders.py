"""Orders of a VDA 5050 master for one robot: each released node becomes a task. Pure: states are passed in.

The ids of tasks follow from the robot, the order and the node's sequence id. So the same order gives the same tasks
after a restart, and the coordinator's journal has their states.
"""

import hashlib
import re
from itertools import zip_longest
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from robrain.deploy.vda5050 import messages as vda
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.tasks.stock_kinds import VISIT
from robrain.protocol.model.tasks.task import Task, TaskState

UNUSED_OF_EDGES = {
    "trajectory", "corridor", "maxSpeed", "maximumSpeed", "maxHeight", "maximumMobileRobotHeight", "minHeight",
    "minimumLoadHandlingDeviceHeight", "orientation", "direction", "maxRotationSpeed",
}  # fmt: skip
"""Optional fields of an edge that bind a vehicle, and that robots cannot obey."""
WAIT = "wait"
"""The action of a node that robots do: they stay for its parameter `duration`, seconds."""
WaitTime = Annotated[float, Meta(ge=0.0, le=86_400.0)]
NEAR_M = 0.5
"""A robot stands on a node within this distance, if the node does not allow more."""
INSTANT_MAX = 32
_NOT_A_NAME = re.compile(r"[^A-Za-z0-9_]")


class KeptOrder(vda.VdaStruct):
    """The current order with all its updates, as the gateway keeps it on disk."""

    order_id: str = ""
    order_update_id: int = 0
    nodes: list[vda.OrderNode] = msgspec.field(default_factory=list)
    edges: list[vda.OrderEdge] = msgspec.field(default_factory=list)
    cancelled_by: list[str] = msgspec.field(default_factory=list)
    """Ids of the actions that cancelled it."""


class NodeTask(msgspec.Struct):
    """The task of a node."""

    node: vda.OrderNode
    task: Task
    state: TaskState | None = None
    """None until the coordinator has replied."""
    why: str = ""

    @property
    def has_ended(self) -> bool:
        """Whether its state stays."""
        return self.state is not None and self.state.ended


class _Refused(Exception):
    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


class EdgesAsSent(vda.VdaStruct):
    """The edges of an order with all fields."""

    edges: list[dict[str, Any]]


class RobotOrders:
    """Handles orders and their cancellation by the rules of the standard.

    Args:
        vehicle: the robot's address; its serial number is the robot's name.
        kept: the order from before a restart.

    """

    def __init__(self, vehicle: vda.Vehicle, kept: KeptOrder) -> None:
        self.kept = kept
        self.instant: dict[str, vda.ActionState] = {}
        """Instant actions, the latest last."""
        self.tasks: dict[str, NodeTask] = {}
        """The tasks of the released nodes, in turn, by id."""
        self._vehicle = vehicle
        self._rejections: list[vda.VehicleError] = []
        self._update_tasks()

    # -- the master's side --------------------------------------------------------------------------------------------

    def handle_order(self, order: vda.VehicleOrder, payload: bytes, state: RobotState | None) -> bool:
        """Accept or reject an order; whether the kept order has changed.

        Args:
            order: from the master.
            payload: the message, which may have further fields.
            state: of the robot; None if it is unknown.

        """
        kept = self.kept
        is_update = order.order_id == kept.order_id and bool(kept.nodes)
        last = (kept.order_update_id, kept.nodes[-len(order.nodes) :])
        if is_update and (order.order_update_id, order.nodes) == last:
            return False  # it has come twice
        try:
            self._check_form(order, payload)
            if not is_update:
                self._check_start(order, state)
            nodes, edges = self._base(order) if is_update else ([], [])
        except _Refused as error:
            if error.kind != "SAME_ORDER_UPDATE_ID" or not self._vehicle.is_old:
                update = str(order.order_update_id)
                self.reject(error.kind, str(error), orderId=order.order_id, orderUpdateId=update)
            return False
        nodes, edges = [*nodes, *order.nodes], [*edges, *order.edges]
        self.kept = KeptOrder(order.order_id, order.order_update_id, nodes, edges)
        self._rejections.clear()
        if not is_update:
            self.instant = {key: one for key, one in self.instant.items() if one.action_status not in vda.ENDED}
        self._update_tasks()
        return True

    def reject(self, kind: str, text: str, **references: str) -> None:
        """Report a message that is rejected; `kind` is an error type of version 3."""
        self._rejections = [*self._rejections[-7:], self._error(kind, text, references)]

    def cancel(self, action: vda.OrderAction) -> bool:
        """Cancel the order; whether the kept order has changed."""
        wanted = action.parameter("orderId")
        if self.is_idle or self.kept.cancelled_by or wanted not in (None, self.kept.order_id):
            self.reject("NO_ORDER_TO_CANCEL", "there is no such order", actionId=action.action_id)
            self.set_instant(action, "FAILED")
            return False
        self.kept.cancelled_by = [action.action_id]
        self.set_instant(action, "RUNNING")
        for one in self.tasks.values():
            one.state = one.state if one.has_ended else None
        return True

    def refuse_action(self, action: vda.OrderAction) -> None:
        """Report an instant action that robots cannot do."""
        self.reject("INVALID_INSTANT_ACTION", f"no robot can {action.action_type}", actionId=action.action_id)
        self.set_instant(action, "FAILED")

    def set_instant(self, action: vda.OrderAction, status: vda.ActionStatus) -> None:
        """Report the state of an instant action."""
        self.instant[action.action_id] = vda.ActionState(action.action_id, status, action.action_type)
        if len(self.instant) > INSTANT_MAX:
            del self.instant[next(iter(self.instant))]

    def _error(self, kind: str, text: str, references: dict[str, str]) -> vda.VehicleError:
        words, found = self._vehicle.words, [vda.Reference(key, value) for key, value in references.items()]
        return vda.VehicleError(words.errors.get(kind, kind), words.levels.get(kind, "WARNING"), text[:4096], found)

    def _check_form(self, order: vda.VehicleOrder, payload: bytes) -> None:
        nodes, edges = order.nodes, order.edges
        parts = [part for pair in zip_longest(nodes, edges) for part in pair if part is not None]
        numbers, first = [part.sequence_id for part in parts], nodes[0].sequence_id
        if len(edges) != len(nodes) - 1 or first % 2 or numbers != list(range(first, first + len(parts))):
            raise _Refused("VALIDATION_FAILURE", "expected nodes and edges in turn, with sequence ids that count on")
        released = [part.released for part in parts]
        if not released[0] or sorted(released, reverse=True) != released or sum(released) % 2 == 0:
            raise _Refused("VALIDATION_FAILURE", "expected released nodes and edges before all others")
        for node in nodes:
            if not node.node_position:
                raise _Refused("VALIDATION_FAILURE", f"node {node.node_id}: expected nodePosition")
            if node.node_position.theta is not msgspec.UNSET:
                raise _Refused("UNSUPPORTED_PARAMETER", "order.nodes.nodePosition.theta: robots choose their heading")
            if self._vehicle.map_id != node.node_position.map_id:
                raise _Refused("UNKNOWN_MAP_ID", f"expected mapId {self._vehicle.map_id}")
        for fields in msgspec.json.decode(payload, type=EdgesAsSent).edges:
            for name in UNUSED_OF_EDGES & fields.keys():
                raise _Refused("UNSUPPORTED_PARAMETER", f"order.edges.{name}: robots choose their path and speed")
        waits = [action for node in nodes for action in node.actions if _wait_s(action) is not None]
        for action in (action for part in parts for action in part.actions if action not in waits):
            raise _Refused("INVALID_ORDER_ACTION", f"action {action.action_id}: {action.action_type}")

    def _base(self, order: vda.VehicleOrder) -> tuple[list[vda.OrderNode], list[vda.OrderEdge]]:
        """The base before the first node of an update."""
        kept = self.kept
        if order.order_update_id < kept.order_update_id:
            raise _Refused("OUTDATED_ORDER_UPDATE", f"orderUpdateId is {kept.order_update_id} already")
        if order.order_update_id == kept.order_update_id:
            raise _Refused("SAME_ORDER_UPDATE_ID", "this orderUpdateId had another content")
        if kept.cancelled_by:
            raise _Refused("ORDER_UPDATE_FOLLOWING_CANCEL", "the order was cancelled")
        base = [node for node in kept.nodes if node.released]
        last, first = base[-1], order.nodes[0]
        if (last.node_id, last.sequence_id) != (first.node_id, first.sequence_id):
            raise _Refused("NO_CONTINUATION", f"expected node {last.node_id} with sequenceId {last.sequence_id} first")
        if len(base) + len(order.nodes) > vda.NODES_MAX:
            raise _Refused("INSUFFICIENT_MEMORY", f"expected at most {vda.NODES_MAX} nodes in an order")
        return base[:-1], [edge for edge in kept.edges if edge.released]

    def _check_start(self, order: vda.VehicleOrder, state: RobotState | None) -> None:
        """Check that a new order can begin."""
        if not self.is_idle:
            raise _Refused("OTHER_ORDER_ACTIVE", f"order {self.kept.order_id} is active")
        if order.order_update_id or order.nodes[0].sequence_id:
            raise _Refused("VALIDATION_FAILURE", "expected orderUpdateId 0 and sequenceId 0 of a new order")
        if state is None or state.pose is None or state.lost:
            raise _Refused("MOBILE_ROBOT_NOT_AVAILABLE", "the robot does not know its position")
        at = order.nodes[0].node_position
        assert at
        away_m = state.pose.distance_m(self._vehicle.place(at))
        if away_m > max(at.deviation_m, NEAR_M):
            raise _Refused("START_NODE_OUT_OF_RANGE", f"the robot is {away_m:.2f} m away from the first node")

    # -- the team's side ----------------------------------------------------------------------------------------------

    def to_ask(self, *, is_due: bool) -> list[NodeTask]:
        """Tasks to submit, or to cancel if the order is cancelled: those without a reply; if `is_due`, the next one."""
        opened = [one for one in self.tasks.values() if not one.has_ended]
        return [one for one in opened if one.state is None or (is_due and one is opened[0])]

    def record(self, task_id: str, state: TaskState, why: str) -> None:
        """Record the state of a task; an end stays."""
        task = self.tasks.get(task_id)
        if task is not None and not task.has_ended:
            task.state, task.why = state, why

    def _update_tasks(self) -> None:
        before, self.tasks = self.tasks, {}
        serial = self._vehicle.serial
        digest = hashlib.sha256(f"{serial}/{self.kept.order_id}".encode()).hexdigest()[:10]
        name = f"{_NOT_A_NAME.sub('_', self.kept.order_id)[:32]}-{digest}"
        after: list[str] = []
        for node in self.kept.nodes:
            service_s = sum(_wait_s(action) or 0.0 for action in node.actions)
            if not node.released or not node.node_position or (node.sequence_id == 0 and not service_s):
                continue
            fields: dict[str, Any] = {"id": f"{name}-{node.sequence_id}", "needs": [serial], "after": after}
            task = Task(kind=VISIT, place=self._vehicle.place(node.node_position), service_s=service_s, **fields)
            self.tasks[task.id] = before.get(task.id) or NodeTask(node, task)
            after = [task.id]

    # -- state --------------------------------------------------------------------------------------------------------

    @property
    def reached(self) -> vda.OrderNode | None:
        """The last node that the robot has reached; None before the first order."""
        opened = (one.node.sequence_id for one in self.tasks.values() if one.state is not TaskState.DONE)
        first = min(opened, default=2**32)
        found = [node for node in self.kept.nodes if node.released and node.sequence_id < first]
        return next(reversed(found), None) or next(iter(self.kept.nodes), None)

    @property
    def remaining(self) -> tuple[list[vda.OrderNode], list[vda.OrderEdge]]:
        """The nodes and edges ahead; none of a cancelled order whose tasks have ended."""
        reached = self.reached
        if reached is None or self._is_cancelled:
            return [], []
        nodes = [node for node in self.kept.nodes if node.sequence_id > reached.sequence_id]
        return nodes, [edge for edge in self.kept.edges if edge.sequence_id > reached.sequence_id]

    @property
    def is_idle(self) -> bool:
        """Whether a new order may begin."""
        return not self.remaining[0] and all(one.has_ended for one in self.tasks.values())

    @property
    def _is_cancelled(self) -> bool:
        """Whether the order was cancelled and its tasks have ended."""
        return bool(self.kept.cancelled_by) and all(one.has_ended for one in self.tasks.values())

    def action_states(self, pose: Pose2D | None) -> list[vda.ActionState]:
        """States of the order's actions.

        Args:
            pose: of the robot, arena frame.

        """
        tasks = {one.node.sequence_id: one for one in self.tasks.values()}
        found = []
        for node in self.kept.nodes:
            one = tasks.get(node.sequence_id)
            status: vda.ActionStatus = "WAITING"
            if one is not None and one.state is TaskState.DONE:
                status = "FINISHED"
            elif self._is_cancelled or (one is not None and one.has_ended):
                status = "FAILED"
            elif one and pose and one.state is TaskState.RUNNING and pose.distance_m(one.task.place) < NEAR_M:
                status = "RUNNING"
            found += [vda.ActionState(action.action_id, status, action.action_type) for action in node.actions]
        return found

    def instant_states(self) -> list[vda.ActionState]:
        """States of instant actions; a cancellation is finished once all tasks have ended."""
        if self._is_cancelled:
            for action_id in self.kept.cancelled_by:
                self.instant[action_id] = vda.ActionState(action_id, "FINISHED", "cancelOrder")
        return list(self.instant.values())

    def errors(self) -> list[vda.VehicleError]:
        """Rejections of messages, and the node that was not reached."""
        found = list(self._rejections)
        for one in self.tasks.values():
            if not self.kept.cancelled_by and one.state in (TaskState.FAILED, TaskState.CANCELLED):
                text = f"{one.node.node_id}: {one.why}"
                return [*found, self._error("NODE_UNREACHABLE", text, {"nodeId": one.node.node_id})]
        return found


def _wait_s(action: vda.OrderAction) -> float | None:
    """Duration of a wait; None for an action that robots cannot do."""
    if action.action_type != WAIT or action.blocking_type not in ("SOFT", "HARD"):
        return None
    try:
        return msgspec.convert(action.parameter("duration"), WaitTime, strict=False)
    except msgspec.ValidationError:
        return None
