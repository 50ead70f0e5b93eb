"""`robrain vda5050 fleet`: a VDA 5050 master sees the robots of a team as vehicles, and gives them orders.

Each released node of an order becomes a task. The ids of tasks follow from the robot, the order and the node's sequence
id. So the same order gives the same tasks after a restart, and the coordinator's journal has their states.
"""

import hashlib
import math
import re
from collections.abc import Iterator
from contextlib import ExitStack, closing
from functools import partial
from itertools import accumulate, chain, pairwise, zip_longest
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from robrain.client.asker import Asker
from robrain.client.halting import HaltReport, order_robot
from robrain.deploy.command_line.options import make_folder, write_file
from robrain.deploy.command_line.output import print_result
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.live_process import LiveStop, SendTimes, wire_when_there
from robrain.deploy.vda5050 import messages as vda
from robrain.deploy.vda5050.mqtt_link import PERIOD_S, Broker, MqttLink
from robrain.protocol.clock import steps, to_ns
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots import robot_messages
from robrain.protocol.messages.robots.robot_messages import PlannedPath, RobotState
from robrain.protocol.messages.tasks import task_messages
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT
from robrain.protocol.messages.tasks.task_messages import TaskRecord, TaskRequest, TaskSubmission
from robrain.protocol.messages.team.team_messages import Halt
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.tasks.stock_kinds import VISIT
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.refusals import RefusalCode
from robrain.protocol.topic import Query
from robrain.protocol.wire.endpoint import Endpoint

STATE_NS, STATE_LEAST_NS, VISUALIZATION_NS = to_ns(1.0), to_ns(0.05), to_ns(0.5)
CHECK_NS = to_ns(2.0)
"""Period of the query for the state of an open task, in addition to the events."""
WAYPOINTS_MAX = 100
ROBOTS_MAX = 256
BY = "vda5050"
TaskOutcome = tuple[TaskState, str]
"""State of a task, and its reason."""
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
Refusal = tuple[str, str]
"""An error type of version 3, and the text."""


class KeptOrder(vda.VehicleOrder):
    """The current order with all its updates, as the gateway keeps it on disk; its id is empty before the first one."""

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


class RobotVehicle:
    """A robot as a vehicle: handles orders and their cancellation by the rules of the standard.

    Args:
        link: of the vehicle; its serial number is the robot's name.
        file: keeps the order.
        state: of the robot.
        wire: of the team.
        tasks: asks the coordinator.
        halts: asks robots.

    """

    def __init__(
        self, link: MqttLink, file: Path, state: RobotState, wire: Endpoint, tasks: Asker, halts: Asker
    ) -> None:
        self.state = state
        self.path: PlannedPath | None = None
        self.kept = read_order(file)
        self.instant: dict[str, vda.ActionState] = {}
        """Instant actions, the latest last."""
        self.tasks: dict[str, NodeTask] = {}
        """The tasks of the released nodes, in turn, by id."""
        self._vehicle, self._file, self._mqtt, self._wire = link.vehicle, file, link, wire
        self._coordinator, self._robots = tasks, halts
        self._rejections: list[vda.VehicleError] = []
        self._is_asking = self._has_failed = False
        """Whether the coordinator has yet to reply, and whether it did not reply to the last question."""
        self._times = SendTimes()
        self._last: Any = None
        self._update_tasks()

    def handle_order(self, order: vda.VehicleOrder, payload: bytes) -> None:
        """Accept or reject an order.

        Args:
            order: from the master.
            payload: the message, which may have further fields.

        """
        kept, nodes, edges = self.kept, order.nodes, order.edges
        is_update = order.order_id == kept.order_id and bool(kept.nodes)
        if is_update and (order.order_update_id, nodes) == (kept.order_update_id, kept.nodes[-len(nodes) :]):
            return  # it has come twice
        others = self._update_refusals(order) if is_update else self._start_refusals(order)
        for kind, text in chain(self._form_refusals(order, payload), others):  # the first one counts
            self.reject(kind, text, orderId=order.order_id, orderUpdateId=str(order.order_update_id))
            return
        if is_update:
            nodes = [*self._base[:-1], *nodes]
            edges = [*(edge for edge in kept.edges if edge.released), *edges]
        else:
            self.instant = {key: one for key, one in self.instant.items() if one.action_status not in vda.ENDED}
        self._keep(KeptOrder(order.order_id, order.order_update_id, nodes, edges))
        self._rejections = []
        self._update_tasks()

    def reject(self, kind: str, text: str, **references: str) -> None:
        """Report a message that is rejected; `kind` is an error type of version 3."""
        error = self._error(kind, text, references)
        if error.error_type:
            self._rejections = [*self._rejections[-7:], error]

    def cancel(self, action: vda.OrderAction) -> None:
        """Cancel the order."""
        wanted = action.parameter("orderId")
        if self.is_idle or self.kept.cancelled_by or wanted not in (None, self.kept.order_id):
            self.fail(action, "NO_ORDER_TO_CANCEL", "there is no such order")
            return
        self._keep(msgspec.structs.replace(self.kept, cancelled_by=[action.action_id]))
        self.set_instant(action, "RUNNING")
        for one in self.tasks.values():
            one.state = one.state if one.has_ended else None

    def _keep(self, order: KeptOrder) -> None:
        """Change the order; it is on disk before it is acknowledged."""
        self.kept = order
        write_file(self._file, msgspec.json.encode(order))

    def fail(self, action: vda.OrderAction, kind: str, text: str) -> None:
        """Reject an instant action; `kind` is an error type of version 3."""
        self.reject(kind, text, actionId=action.action_id)
        self.set_instant(action, "FAILED")

    def set_instant(self, action: vda.OrderAction, status: vda.ActionStatus) -> None:
        """Report the state of an instant action."""
        self.instant[action.action_id] = vda.ActionState(action.action_id, status, action.action_type)
        if len(self.instant) > INSTANT_MAX:
            del self.instant[next(iter(self.instant))]

    def _error(self, kind: str, text: str, references: dict[str, str]) -> vda.VehicleError:
        words, found = self._vehicle.words, [vda.Reference(key, value) for key, value in references.items()]
        return vda.VehicleError(words.errors.get(kind, kind), words.levels.get(kind, "WARNING"), text[:4096], found)

    @property
    def _base(self) -> list[vda.OrderNode]:
        return [node for node in self.kept.nodes if node.released]

    def _form_refusals(self, order: vda.VehicleOrder, payload: bytes) -> Iterator[Refusal]:
        """Rules for all orders that this one breaks."""
        nodes, edges = order.nodes, order.edges
        parts = [part for pair in zip_longest(nodes, edges) for part in pair if part is not None]
        numbers, first = [part.sequence_id for part in parts], nodes[0].sequence_id
        if len(edges) != len(nodes) - 1 or first % 2 or numbers != list(range(first, first + len(parts))):
            yield "VALIDATION_FAILURE", "expected nodes and edges in turn, with sequence ids that count on"
        released = [part.released for part in parts]
        if not released[0] or sorted(released, reverse=True) != released or sum(released) % 2 == 0:
            yield "VALIDATION_FAILURE", "expected released nodes and edges before all others"
        for node in nodes:
            if not node.node_position:
                yield "VALIDATION_FAILURE", f"node {node.node_id}: expected nodePosition"
            elif node.node_position.theta is not msgspec.UNSET:
                yield "UNSUPPORTED_PARAMETER", "order.nodes.nodePosition.theta: robots choose their heading"
            elif self._vehicle.map_id != node.node_position.map_id:
                yield "UNKNOWN_MAP_ID", f"expected mapId {self._vehicle.map_id}"
        sent = msgspec.json.decode(payload, type=dict[str, msgspec.Raw])["edges"]
        for fields in msgspec.json.decode(sent, type=list[dict[str, msgspec.Raw]]):
            for name in UNUSED_OF_EDGES & fields.keys():
                yield "UNSUPPORTED_PARAMETER", f"order.edges.{name}: robots choose their path and speed"
        waits = [action for node in nodes for action in node.actions if _wait_s(action) is not None]
        for action in (action for part in parts for action in part.actions if action not in waits):
            yield "INVALID_ORDER_ACTION", f"action {action.action_id}: {action.action_type}"

    def _update_refusals(self, order: vda.VehicleOrder) -> Iterator[Refusal]:
        """Rules for updates that this one breaks."""
        kept, base, first = self.kept, self._base, order.nodes[0]
        if order.order_update_id < kept.order_update_id:
            yield "OUTDATED_ORDER_UPDATE", f"orderUpdateId is {kept.order_update_id} already"
        if order.order_update_id == kept.order_update_id:
            yield "SAME_ORDER_UPDATE_ID", "this orderUpdateId had another content"
        if kept.cancelled_by:
            yield "ORDER_UPDATE_FOLLOWING_CANCEL", "the order was cancelled"
        last = base[-1]
        if (last.node_id, last.sequence_id) != (first.node_id, first.sequence_id):
            yield "NO_CONTINUATION", f"expected node {last.node_id} with sequenceId {last.sequence_id} first"
        if len(base) + len(order.nodes) > vda.NODES_MAX:
            yield "INSUFFICIENT_MEMORY", f"expected at most {vda.NODES_MAX} nodes in an order"

    def _start_refusals(self, order: vda.VehicleOrder) -> Iterator[Refusal]:
        """Rules for new orders that this one breaks."""
        first, state = order.nodes[0], self.state
        if not self.is_idle:
            yield "OTHER_ORDER_ACTIVE", f"order {self.kept.order_id} is active"
        if order.order_update_id or first.sequence_id:
            yield "VALIDATION_FAILURE", "expected orderUpdateId 0 and sequenceId 0 of a new order"
        if state.pose is None or state.lost:
            yield "MOBILE_ROBOT_NOT_AVAILABLE", "the robot does not know its position"
        elif first.node_position:
            away_m = state.pose.distance_m(self._vehicle.place(first.node_position))
            if away_m > max(first.node_position.deviation_m, NEAR_M):
                yield "START_NODE_OUT_OF_RANGE", f"the robot is {away_m:.2f} m away from the first node"

    def task_to_ask(self, *, is_due: bool) -> Task | None:
        """The first task without a reply; if `is_due`, the first one. The coordinator must know it before the next."""
        opened = [one for one in self.tasks.values() if not one.has_ended]
        return next((one.task for one in opened if is_due or one.state is None), None)

    def record(self, task_id: str, state: TaskState, why: str) -> None:
        """Record the state of a task; an end stays."""
        task = self.tasks.get(task_id)
        if task is not None and not task.has_ended:
            task.state, task.why = state, why

    def _update_tasks(self) -> None:
        before, self.tasks, serial = self.tasks, {}, self._vehicle.serial
        digest = hashlib.sha256(f"{serial}/{self.kept.order_id}".encode()).hexdigest()[:10]
        name = f"{_NOT_A_NAME.sub('_', self.kept.order_id)[:32]}-{digest}"
        after: tuple[str, ...] = ()
        for node in self._base:
            service_s = sum(_wait_s(action) or 0.0 for action in node.actions)
            if node.node_position and (node.sequence_id or service_s):
                key, place = f"{name}-{node.sequence_id}", self._vehicle.place(node.node_position)
                task = Task(id=key, kind=VISIT, place=place, service_s=service_s, needs=(serial,), after=after)
                self.tasks[key] = before.get(key) or NodeTask(node, task)
                after = (key,)

    @property
    def reached(self) -> vda.OrderNode | None:
        """The last node that the robot has reached; None before the first order."""
        opened = (one.node.sequence_id for one in self.tasks.values() if one.state is not TaskState.DONE)
        first = min(opened, default=2**32)
        found = [*self.kept.nodes[:1], *(node for node in self._base if node.sequence_id < first)]
        return found[-1] if found else None

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
            if one and one.state is TaskState.DONE:
                status = "FINISHED"
            elif self._is_cancelled or (one and one.has_ended):
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
        lost = [one for one in self.tasks.values() if one.state in (TaskState.FAILED, TaskState.CANCELLED)]
        if not lost or self.kept.cancelled_by:
            return self._rejections
        node, why = lost[0].node, lost[0].why
        return [*self._rejections, self._error("NODE_UNREACHABLE", f"{node.node_id}: {why}", {"nodeId": node.node_id})]

    def step(self, now_ns: int) -> None:
        """Process messages, call the team, and publish."""
        if self._mqtt.is_new:
            self._mqtt.is_new = False
            self._mqtt.publish("connection", {"connectionState": "ONLINE"})
            self._mqtt.publish("factsheet", factsheet(self._vehicle, self.state))
        for message, payload in self._mqtt.receive():
            self._handle(message, payload)
        self._ask_team(now_ns)
        self._publish_state(self.state, now_ns)

    def close(self) -> None:
        """Report the vehicle as offline, and disconnect."""
        self._mqtt.publish("connection", {"connectionState": "OFFLINE"})
        self._mqtt.close()

    def _handle(self, message: vda.VdaStruct | vda.BadVehicleMessage, payload: bytes) -> None:
        self._last = None
        match message:
            case vda.VehicleOrder() as order:
                self.handle_order(order, payload)
            case vda.InstantActions(actions=actions):
                for action in actions:
                    if action.action_id not in self.instant:  # else it has come twice
                        self._do(action)
            case error:
                self.reject("VALIDATION_FAILURE", str(error))

    def _do(self, action: vda.OrderAction) -> None:
        match action.action_type:
            case "cancelOrder":
                self.cancel(action)
            case "startPause" | "stopPause" as kind:
                self.set_instant(action, "RUNNING")
                wanted = Halt(halted=kind == "startPause", by=BY, reason=kind)
                ask = partial(order_robot, self._wire, self._vehicle.serial, wanted)
                self._robots.call(ask, partial(self._record_halt, action))
            case "stateRequest" | "factsheetRequest" as kind:
                if kind == "factsheetRequest":
                    self._mqtt.publish("factsheet", factsheet(self._vehicle, self.state))
                self.set_instant(action, "FINISHED")
            case kind:
                self.fail(action, "INVALID_INSTANT_ACTION", f"no robot can {kind}")

    def _record_halt(self, action: vda.OrderAction, found: HaltReport | None, _error: str) -> None:
        self.set_instant(action, "FAILED" if found is None or found.unconfirmed else "FINISHED")

    def _ask_team(self, now_ns: int) -> None:
        if self._is_asking:
            return
        is_due = self._times.is_due("check", CHECK_NS, now_ns)
        task = self.task_to_ask(is_due=is_due)
        if task is not None and (is_due or not self._has_failed):
            self._is_asking, is_cancelled = True, bool(self.kept.cancelled_by)
            ask = partial(ask_coordinator, self._wire, task, is_cancelled=is_cancelled)
            self._coordinator.call(ask, partial(self._record_reply, task.id))

    def _record_reply(self, task_id: str, found: TaskOutcome | None, error: str) -> None:
        self._is_asking, self._has_failed = False, found is None
        if found is None:  # no coordinator answers
            self._wire.refusals.record("vda5050", task_id, RefusalCode.LOST, error)
        else:
            self.record(task_id, *found)

    def _publish_state(self, robot: RobotState, now_ns: int) -> None:
        vehicle, speed = self._vehicle, robot.velocity
        charging, soc = (False, 1.0) if robot.battery is None else (robot.battery.charging, robot.battery.soc)
        actions, instant = self.action_states(robot.pose), self.instant_states()
        reached, (nodes, edges) = self.reached, self.remaining
        news: dict[str, Any] = {
            "orderId": self.kept.order_id,
            "orderUpdateId": self.kept.order_update_id,
            "lastNodeId": "" if reached is None else reached.node_id,
            "lastNodeSequenceId": 0 if reached is None else reached.sequence_id,
            "nodeStates": [_state_of(node, "node") for node in nodes],
            "edgeStates": [_state_of(edge, "edge") for edge in edges],
            "driving": any(msgspec.structs.astuple(speed)),
            "paused": robot.halted,
            "operatingMode": "AUTOMATIC",
            "errors": self.errors(),
            "actionStates": actions + instant if vehicle.version is vda.Version.V2_1 else actions,
            "instantActionStates": instant,
            "powerSupply": {"charging": charging, "stateOfCharge": min(max(100.0 * soc, 0.0), 100.0)},
            "safetyState": {"activeEmergencyStop": "NONE", "fieldViolation": False},
        }
        moving: dict[str, Any] = {"velocity": {"vx": speed.forward_m_s, "vy": speed.left_m_s, "omega": speed.yaw_rad_s}}
        if robot.pose is not None:
            at = vehicle.from_arena(robot.pose.x_m, robot.pose.y_m, robot.pose.yaw_rad)
            where = vda.Position(at.x_m, at.y_m, at.yaw_rad, vehicle.map_id, localized=not robot.lost)
            moving["mobileRobotPosition"] = where
        moving |= _paths(vehicle, self.path, now_ns)
        is_new = news != self._last and self._times.is_due("news", STATE_LEAST_NS, now_ns)
        if self._times.is_due("state", 0 if is_new else STATE_NS, now_ns):
            self._last = news
            self._mqtt.publish("state", news | moving)
        if self._times.is_due("visualization", VISUALIZATION_NS, now_ns):
            self._mqtt.publish("visualization", moving | {"referenceStateHeaderId": self._mqtt.sent["state"] - 1})


def _wait_s(action: vda.OrderAction) -> float | None:
    """Duration of a wait; None for an action that robots cannot do."""
    if action.action_type != WAIT or action.blocking_type not in ("SOFT", "HARD"):
        return None
    try:
        return msgspec.convert(action.parameter("duration"), WaitTime, strict=False)
    except msgspec.ValidationError:
        return None


def read_order(path: Path) -> KeptOrder:
    """The order in a file; a blank one if there is no file (UsageError if it is damaged)."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=KeptOrder) if path.exists() else KeptOrder("", 0, [], [])
    except (OSError, msgspec.DecodeError) as error:
        raise UsageError(f"{path}: {error}; move it away, and cancel the robot's tasks") from error


def ask_coordinator(wire: Endpoint, task: Task, *, is_cancelled: bool) -> TaskOutcome:
    """Submit a task, or cancel it. A task that is refused has failed; a cancelled one that is unknown is cancelled.

    Raises:
        RobrainError: there is no answer.

    """
    outcome: TaskOutcome = TaskState.FAILED, ""
    asked: Any = TaskSubmission(task=task, by=BY)
    queries: list[Query[Any, TaskRecord]] = [task_messages.TASK_SUBMIT]
    if is_cancelled:
        outcome, asked = (TaskState.CANCELLED, ""), TaskRequest(id=task.id, by=BY, why="cancelOrder")
        queries = [task_messages.TASK_CANCEL, task_messages.TASK_GET]  # one that has ended cannot be cancelled
    for query in queries:
        try:
            record = wire.ask(query, asked)
        except CallError as error:
            if error.code not in (ErrorCode.REFUSED, ErrorCode.BAD_ARGUMENTS):
                raise
            outcome = outcome[0], str(error)
        else:
            return record.state, record.why
    return outcome


def _state_of(part: Any, kind: str) -> dict[str, Any]:
    fields = msgspec.to_builtins(part)
    return {key: fields[key] for key in (f"{kind}Id", "sequenceId", "released")}


def _paths(vehicle: vda.Vehicle, path: PlannedPath | None, now_ns: int) -> dict[str, Any]:
    """The robot's planned path as both paths of version 3; nothing while it stands."""
    if path is None or len(path.points) < 2:
        return {}
    points = [vehicle.waypoint(point.x_m, point.y_m) for point in path.points[:WAYPOINTS_MAX]]
    lengths_m = accumulate((math.dist(*ends) for ends in pairwise((at.x, at.y) for at in points)), initial=0.0)
    etas = (vda.timestamp(now_ns + to_ns(length_m / (path.speed_m_s or SPEED_M_S))) for length_m in lengths_m)
    waypoints = [{"x": at.x, "y": at.y, "eta": eta} for at, eta in zip(points, etas, strict=True)]
    knots = [0.0, *(number / (len(points) - 1) for number in range(len(points))), 1.0]
    curve = {"degree": 1, "knotVector": knots, "controlPoints": points}
    return {"plannedPath": {"trajectory": curve}, "intermediatePath": {"polyline": waypoints}}


SPEED_M_S = 1.0
"""Nominal value, as in `factsheet.json`: a robot does not report it."""


def factsheet(vehicle: vda.Vehicle, robot: RobotState) -> dict[str, Any]:
    """The factsheet of a robot as JSON, without its header."""
    sheet: dict[str, Any] = msgspec.json.decode(Path(__file__).with_name("factsheet.json").read_bytes())
    diameter_m = 2.0 * robot.radius_m
    sheet["physicalParameters"] |= {"width": diameter_m, "length": diameter_m}
    sheet["typeSpecification"] |= vehicle.words.type_specification
    return sheet


def fleet_command(connect: str | None, team: str, broker: Broker, shown: vda.Vehicle, folder: Path) -> None:
    """Show a team's robots as vehicles until Ctrl-C; wait until the endpoints answer.

    Args:
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.
        broker: of MQTT.
        shown: address of a robot, but for its name, which is the serial number.
        folder: for the current orders.

    Raises:
        RobrainError: in one sentence.

    """
    should_stop, who = LiveStop(), "vda5050 fleet"
    make_folder(folder)
    with ExitStack() as stack:
        wire = stack.enter_context(wire_when_there(who, connect, team, should_stop))
        if wire is None:
            return
        tasks, halts = (stack.enter_context(closing(Asker(wire))) for _ in range(2))  # halts wait for no task
        inbox, events = Inbox(4096), Inbox(4096, every=True)
        wire.subscribe(inbox, robot_messages.ROBOT_STATE)
        wire.subscribe(inbox, robot_messages.ROBOT_PATH)
        wire.subscribe(events, TASK_EVENT)
        tokens = wire.watch(robot_messages.ROBOT_ALIVE)
        vehicles: dict[str, RobotVehicle] = {}
        should_stop.ready()
        print_result(f"{who}: team {team} at {broker.host}:{broker.port}, as {shown.topic('')}")
        for _ in steps(should_stop, PERIOD_S):
            tasks.deliver()
            halts.deliver()
            tokens.changes()
            there = {names["robot"] for names in tokens.present.values()}
            for received in inbox.drain():
                name, message = received.message.robot, received.message
                if name in vehicles and isinstance(message, PlannedPath):
                    vehicles[name].path = message
                elif name in vehicles:
                    vehicles[name].state = message
                elif isinstance(message, RobotState) and name in there and len(vehicles) < ROBOTS_MAX:
                    vehicle = shown._replace(serial=name)
                    will = "connection", {"connectionState": vehicle.words.connection_broken}, 0
                    client_id = f"robrain-{vehicle.manufacturer}-{name}"
                    link = MqttLink(vehicle, broker, client_id, ("order", "instantActions"), wire, will)
                    vehicles[name] = RobotVehicle(link, folder / f"{name}.json", message, wire, tasks, halts)
            for name in vehicles.keys() - there:
                vehicles.pop(name).close()
            for event in [received.message for received in events.drain()]:
                for robot in vehicles.values():
                    robot.record(event.task.id, event.state, event.why)
            for robot in vehicles.values():
                robot.step(wire.clock.now_ns())
        for robot in vehicles.values():
            robot.close()
