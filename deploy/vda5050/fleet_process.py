"""`robrain vda5050 fleet`: a VDA 5050 master sees the robots of a team as vehicles, and gives them orders."""

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import msgspec

from robrain.client.submission import TaskFields
from robrain.client.team import Team
from robrain.deploy.command_line.options import make_folder
from robrain.deploy.command_line.output import print_result
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.live_process import LiveStop, live_endpoint, open_when_there
from robrain.deploy.vda5050 import messages as vda
from robrain.deploy.vda5050.mqtt_link import Broker, MqttLink, Packet
from robrain.deploy.vda5050.robot_orders import KeptOrder, NodeTask, RobotOrders
from robrain.protocol.clock import steps, to_ns
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere, RobrainError
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import (
    ROBOT_ALIVE,
    ROBOT_PATH,
    ROBOT_STATE,
    PlannedPath,
    RobotState,
)
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.tasks.stock_kinds import VISIT
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.refusals import RefusalCode
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.hub import team_endpoints

PERIOD_S = 0.02
STATE_NS, STATE_LEAST_NS, VISUALIZATION_NS = to_ns(1.0), to_ns(0.05), to_ns(0.5)
CHECK_NS = to_ns(2.0)
"""Period of the query for the state of an open task, in addition to the events."""
WAYPOINTS_MAX = 100
ROBOTS_MAX = 256
CALLS_MAX = 64
"""Calls of a robot that wait for the team."""
BY = "vda5050"


class OrderFile:
    """The current order of each robot, on disk before it is acknowledged.

    Args:
        folder: for a file per robot; made if it is absent.

    """

    def __init__(self, folder: Path) -> None:
        make_folder(folder)
        self._folder = folder

    def read(self, robot: str) -> KeptOrder:
        """The order of a robot; a blank one if it has none (UsageError if the file is damaged)."""
        path = self._folder / f"{robot}.json"
        try:
            return msgspec.json.decode(path.read_bytes(), type=KeptOrder)
        except FileNotFoundError:
            return KeptOrder()
        except (OSError, msgspec.DecodeError) as error:
            raise UsageError(f"{path}: {error}; move it away, and cancel the robot's tasks") from error

    def write(self, robot: str, kept: KeptOrder) -> None:
        """Replace the order of a robot; it is on disk when this returns."""
        path = self._folder / f"{robot}.json"
        with (new := path.with_suffix(".new")).open("wb") as stream:
            stream.write(msgspec.json.encode(kept))
            stream.flush()
            os.fsync(stream.fileno())
        new.replace(path)


class TeamCalls:
    """Calls the team on threads: a halt must not wait for a task.

    Args:
        connect: makes a client of the team.

    """

    def __init__(self, connect: Callable[[], Team]) -> None:
        self._tasks, self._halts = connect(), connect()
        self._task_pool, self._halt_pool = ThreadPoolExecutor(1, "vda5050-task"), ThreadPoolExecutor(1, "vda5050-halt")

    def submit(self, task: NodeTask, robot: str) -> "Future[tuple[TaskState, str]]":
        """Submit the task of a node; the same task again has the same answer."""
        return self._task_pool.submit(self._submit, task, robot)

    def cancel(self, task_id: str) -> "Future[tuple[TaskState, str]]":
        """Cancel a task; an unknown one counts as cancelled."""
        return self._task_pool.submit(self._cancel, task_id)

    def get(self, task_id: str) -> "Future[tuple[TaskState, str]]":
        """The state of a task."""
        return self._task_pool.submit(self._get, task_id)

    def halt(self, robot: str, *, halted: bool) -> "Future[str]":
        """Halt or resume a robot; the result is the reason why it did not, empty if it did."""
        return self._halt_pool.submit(self._halt, robot, halted)

    def close(self) -> None:
        """End, without the calls that have not begun: the next process repeats them."""
        for pool in (self._task_pool, self._halt_pool):
            pool.shutdown(cancel_futures=True)
        self._tasks.close()
        self._halts.close()

    def _submit(self, task: NodeTask, robot: str) -> tuple[TaskState, str]:
        fields: TaskFields = {"id": task.id, "place": task.place, "service_s": task.service_s, "needs": [robot]}
        fields["after"] = [task.after] if task.after else []
        return _state_or(TaskState.FAILED, lambda: self._tasks.submit(VISIT, **fields))

    def _cancel(self, task_id: str) -> tuple[TaskState, str]:
        state, why = _state_or(TaskState.QUEUED, lambda: self._tasks.cancel(task_id, why="cancelOrder"))
        return self._get(task_id) if state is TaskState.QUEUED else (state, why)

    def _get(self, task_id: str) -> tuple[TaskState, str]:
        return _state_or(TaskState.CANCELLED, lambda: self._tasks.get(task_id))

    def _halt(self, robot: str, halted: bool) -> str:
        order = self._halts.halt if halted else self._halts.resume
        try:
            return "; ".join(order(robot, by=BY).unconfirmed.values())
        except (CallError, NobodyThere) as error:
            return str(error)


def _state_or(refused: TaskState, call: Callable[[], TaskRecord]) -> tuple[TaskState, str]:
    """State of a task, or the given one if the coordinator refuses the call for good."""
    try:
        record = call()
    except CallError as error:
        if error.code not in (ErrorCode.REFUSED, ErrorCode.BAD_ARGUMENTS):
            raise
        return refused, str(error)
    return record.state, record.why


class RobotVehicle:
    """A robot as a vehicle on MQTT.

    Args:
        vehicle: its address; its serial number is the robot's name.
        broker: where it is shown.
        calls: passes tasks and halts on.
        file: keeps the order.
        wire: of the team.

    """

    def __init__(self, vehicle: vda.Vehicle, broker: Broker, calls: TeamCalls, file: OrderFile, wire: Endpoint) -> None:
        self.state: RobotState | None = None
        self.path: PlannedPath | None = None
        self.orders = RobotOrders(vehicle, file.read(vehicle.serial))
        self._vehicle, self._calls, self._file, self._refusals = vehicle, calls, file, wire.refusals
        self._waiting: dict[str, Future[tuple[TaskState, str]]] = {}
        self._halting: list[tuple[vda.OrderAction, Future[str]]] = []
        self._header_ids: dict[str, int] = {}
        self._sent_ns: dict[str, int] = {}
        self._last: Any = None
        self._connections = 0
        broken = {"connectionState": "CONNECTIONBROKEN" if vehicle.is_old else "CONNECTION_BROKEN"}
        will = Packet(vehicle.topic("connection"), vehicle.payload(broken, 0, wire.clock.now_ns()), 1, True)
        topics = [vehicle.topic("order"), vehicle.topic("instantActions")]
        self._mqtt = MqttLink(broker, f"robrain-{vehicle.manufacturer}-{vehicle.serial}", topics, wire.refusals, will)

    def step(self, now_ns: int) -> None:
        """Process messages, call the team, and publish."""
        if self._mqtt.connections != self._connections:
            self._connections = self._mqtt.connections
            self._publish("connection", {"connectionState": "ONLINE"}, now_ns)
            self._publish("factsheet", factsheet(self._vehicle, self.state), now_ns)
        for packet in self._mqtt.drain():
            self._handle(packet, now_ns)
        self._call_team(now_ns)
        self._publish_state(now_ns)

    def close(self, now_ns: int) -> None:
        """Report the vehicle as offline, and disconnect."""
        self._publish("connection", {"connectionState": "OFFLINE"}, now_ns)
        self._mqtt.close()

    def _handle(self, packet: Packet, now_ns: int) -> None:
        try:
            if packet.topic == self._vehicle.topic("order"):
                order = vda.read(packet.topic, packet.payload, vda.VehicleOrder)
                if self.orders.handle_order(order, packet.payload, self.state):
                    self._file.write(self._vehicle.serial, self.orders.kept)
            else:
                for action in vda.read(packet.topic, packet.payload, vda.InstantActions).actions:
                    self._do(action, now_ns)
        except vda.BadVehicleMessage as error:
            self._refusals.record("vda5050", packet.topic, RefusalCode.MALFORMED, str(error))
            self.orders.reject_payload(str(error))
        self._last = None

    def _do(self, action: vda.OrderAction, now_ns: int) -> None:
        orders = self.orders
        if action.action_id in orders.instant:
            return  # it has come twice
        match action.action_type:
            case "cancelOrder":
                if orders.cancel(action):
                    self._file.write(self._vehicle.serial, orders.kept)
            case "startPause" | "stopPause" if len(self._halting) < CALLS_MAX:
                orders.set_instant(action, "RUNNING")
                is_start = action.action_type == "startPause"
                self._halting.append((action, self._calls.halt(self._vehicle.serial, halted=is_start)))
            case "stateRequest":
                orders.set_instant(action, "FINISHED")
            case "factsheetRequest":
                self._publish("factsheet", factsheet(self._vehicle, self.state), now_ns)
                orders.set_instant(action, "FINISHED")
            case _:
                orders.refuse_action(action)

    def _call_team(self, now_ns: int) -> None:
        orders, waiting = self.orders, self._waiting
        for task_id in [task_id for task_id, future in waiting.items() if future.done()]:
            try:
                orders.record(task_id, *waiting.pop(task_id).result())
            except RobrainError as error:  # no coordinator answers: it is asked again
                self._refusals.record("vda5050", task_id, RefusalCode.LOST, str(error))
        halting, self._halting = self._halting, []
        for action, halt in halting:
            if halt.done():
                orders.set_instant(action, "FAILED" if halt.result() else "FINISHED")
            else:
                self._halting.append((action, halt))
        is_due = self._is_due("check", CHECK_NS, now_ns)
        if orders.kept.cancelled_by:
            for task in orders.to_cancel():
                if task.id not in waiting and len(waiting) < CALLS_MAX and (is_due or task.id not in self._sent_ns):
                    self._sent_ns[task.id] = now_ns
                    waiting[task.id] = self._calls.cancel(task.id)
            orders.finish_cancel()
            return
        for task in orders.to_submit():
            if task.id not in waiting:
                if task.after in waiting or len(waiting) >= CALLS_MAX:
                    break  # the coordinator must know the task before
                waiting[task.id] = self._calls.submit(task, self._vehicle.serial)
        opened = orders.open_task()
        if is_due and opened is not None and opened.id not in waiting:
            waiting[opened.id] = self._calls.get(opened.id)

    def _publish_state(self, now_ns: int) -> None:
        robot, orders, vehicle = self.state, self.orders, self._vehicle
        if robot is None:
            return
        is_old, speed, battery = vehicle.is_old, robot.velocity, robot.battery
        percent = 100.0 if battery is None else min(max(100.0 * battery.soc, 0.0), 100.0)
        power = {"charging": battery is not None and battery.charging}
        actions, instant = orders.action_states(robot.pose), list(orders.instant.values())
        reached = orders.reached
        news: dict[str, Any] = {
            "orderId": orders.kept.order_id,
            "orderUpdateId": orders.kept.order_update_id,
            "lastNodeId": "" if reached is None else reached.node_id,
            "lastNodeSequenceId": 0 if reached is None else reached.sequence_id,
            "nodeStates": [_state_of(node, "node") for node in orders.remaining],
            "edgeStates": [_state_of(edge, "edge") for edge in orders.remaining_edges],
            "driving": any(msgspec.structs.astuple(speed)),
            "paused": robot.halted,
            "operatingMode": "AUTOMATIC",
            "errors": orders.errors(),
        }
        if is_old:
            news |= {"actionStates": actions + instant, "batteryState": {**power, "batteryCharge": percent}}
            news["safetyState"] = {"eStop": "NONE", "fieldViolation": False}
        else:
            news |= {"actionStates": actions, "instantActionStates": instant}
            news["powerSupply"] = {**power, "stateOfCharge": percent}
            news["safetyState"] = {"activeEmergencyStop": "NONE", "fieldViolation": False}
        moving: dict[str, Any] = {"velocity": {"vx": speed.forward_m_s, "vy": speed.left_m_s, "omega": speed.yaw_rad_s}}
        if robot.pose is not None:
            at = vehicle.from_arena(robot.pose.x_m, robot.pose.y_m, robot.pose.yaw_rad)
            where = {"x": at.x_m, "y": at.y_m, "theta": at.yaw_rad, "mapId": vehicle.map_id}
            known = {"positionInitialized" if is_old else "localized": not robot.lost}
            moving["agvPosition" if is_old else "mobileRobotPosition"] = {**where, **known}
        if not is_old:
            moving |= _paths(vehicle, self.path, now_ns)
        is_new = news != self._last and self._is_due("news", STATE_LEAST_NS, now_ns)
        if is_new or self._is_due("state", STATE_NS, now_ns):
            self._last, self._sent_ns["state"] = news, now_ns
            self._publish("state", news | moving, now_ns)
        if self._is_due("visualization", VISUALIZATION_NS, now_ns):
            refers = {} if is_old else {"referenceStateHeaderId": self._header_ids.get("state", 0)}
            self._publish("visualization", moving | refers, now_ns)

    def _publish(self, name: str, body: dict[str, Any], now_ns: int) -> None:
        self._header_ids[name] = self._header_ids.get(name, -1) + 1
        payload = self._vehicle.payload(body, self._header_ids[name], now_ns)
        is_connection = name == "connection"
        self._mqtt.publish(self._vehicle.topic(name), payload, int(is_connection), is_retained=is_connection)

    def _is_due(self, what: str, period_ns: int, now_ns: int) -> bool:
        if now_ns - self._sent_ns.get(what, -period_ns) < period_ns:
            return False
        self._sent_ns[what] = now_ns
        return True


def _state_of(part: Any, kind: str) -> dict[str, Any]:
    fields = msgspec.to_builtins(part)
    return {key: fields[key] for key in (f"{kind}Id", "sequenceId", "released")}


def _paths(vehicle: vda.Vehicle, path: PlannedPath | None, now_ns: int) -> dict[str, Any]:
    """The robot's planned path as both paths of version 3; nothing while it stands."""
    if path is None or len(path.points) < 2:
        return {}
    points = [vehicle.from_arena(point.x_m, point.y_m) for point in path.points[:WAYPOINTS_MAX]]
    along_m, last, waypoints = 0.0, len(points) - 1, []
    for before, at in zip([points[0], *points], points, strict=False):
        along_m += before.distance_m(at)
        eta_ns = now_ns + to_ns(along_m / (path.speed_m_s or SPEED_M_S))
        waypoints.append({"x": at.x_m, "y": at.y_m, "eta": vda.timestamp(eta_ns)})
    knots = [0.0, *(number / last for number in range(last + 1)), 1.0]
    curve = {"degree": 1, "knotVector": knots, "controlPoints": [{"x": at.x_m, "y": at.y_m} for at in points]}
    return {"plannedPath": {"trajectory": curve}, "intermediatePath": {"polyline": waypoints}}


INSTANT = ("cancelOrder", "startPause", "stopPause", "stateRequest", "factsheetRequest")
SPEED_M_S, HEIGHT_M = 1.0, 1.0
"""Nominal values: a robot does not report them."""
NAMES_3 = {
    "agvKinematic": "mobileRobotKinematics", "agvClass": "mobileRobotClass", "maxLoadMass": "maximumLoadMass",
    "speedMin": "minimumSpeed", "speedMax": "maximumSpeed", "accelerationMax": "maximumAcceleration",
    "decelerationMax": "maximumDeceleration", "heightMin": "minimumHeight", "heightMax": "maximumHeight",
    "maxStringLens": "maximumStringLengths", "idLen": "maximumIdLength", "maxArrayLens": "maximumArrayLengths",
    "minOrderInterval": "minimumOrderInterval", "minStateInterval": "minimumStateInterval",
    "agvActions": "mobileRobotActions", "agvGeometry": "mobileRobotGeometry",
}  # fmt: skip
"""Names of fields of a factsheet in version 3, by those in version 2."""


def factsheet(vehicle: vda.Vehicle, robot: RobotState | None) -> dict[str, Any]:
    """The factsheet of a robot as JSON, without its header."""
    diameter_m = 2.0 * (robot.radius_m if robot is not None else 0.0)
    duration = {"key": "duration", "valueDataType": "NUMBER", "description": "Seconds."}
    actions: list[dict[str, Any]] = [{"actionType": kind, "actionScopes": ["INSTANT"]} for kind in INSTANT]
    actions.append({"actionType": "wait", "actionScopes": ["NODE"], "actionParameters": [duration]})
    if not vehicle.is_old:
        actions[-1]["blockingTypes"] = ["SOFT", "HARD"]  # the schema of 2.1.0 allows no list here
        actions = [{**action, "pauseAllowed": False, "cancelAllowed": True} for action in actions]
    speeds = dict.fromkeys(("speedMax", "accelerationMax", "decelerationMax"), SPEED_M_S)
    size = {"heightMin": 0.0, "heightMax": HEIGHT_M, "width": diameter_m, "length": diameter_m}
    kind = {"agvKinematic": "DIFF", "agvClass": "CARRIER", "navigationTypes": ["AUTONOMOUS"]}
    if not vehicle.is_old:
        kind |= {"agvKinematic": "DIFFERENTIAL", "navigationTypes": ["FREELY_NAVIGATING"]}
    limits = {"order.nodes": vda.NODES_MAX, "order.edges": vda.NODES_MAX}
    timing = {"minOrderInterval": 0.0, "minStateInterval": 0.05, "defaultStateInterval": 1.0}
    required = {"parameter": "order.nodes.nodePosition", "support": "REQUIRED"}
    found = {
        "typeSpecification": {"seriesName": "robrain", "maxLoadMass": 0.0, "localizationTypes": ["NATURAL"], **kind},
        "physicalParameters": {"speedMin": 0.0, **speeds, **size},
        "protocolLimits": {"maxStringLens": {"idLen": vda.ID_MAX}, "maxArrayLens": limits, "timing": timing},
        "protocolFeatures": {"optionalParameters": [required], "agvActions": actions},
        "agvGeometry": {},
        "loadSpecification": {},
    }
    return found if vehicle.is_old else _renamed(found)


def _renamed(content: Any) -> Any:
    if not isinstance(content, dict):
        return content
    return {NAMES_3.get(key, key): _renamed(value) for key, value in content.items()}


def _close_all(vehicles: dict[str, RobotVehicle], now_ns: int) -> None:
    while vehicles:
        vehicles.popitem()[1].close(now_ns)


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
    file = OrderFile(folder)
    with ExitStack() as stack:
        session = open_when_there(who, team_endpoints(connect), should_stop)
        if session is None:
            return
        stack.enter_context(closing(session))
        wire: Endpoint = stack.enter_context(live_endpoint(session, team))
        calls = stack.enter_context(closing(TeamCalls(lambda: Team.connect(connect, team=team, by=BY))))
        inbox, events = Inbox(4096), Inbox(4096, every=True)
        wire.subscribe(inbox, ROBOT_STATE)
        wire.subscribe(inbox, ROBOT_PATH)
        wire.subscribe(events, TASK_EVENT)
        tokens = wire.watch(ROBOT_ALIVE)
        vehicles: dict[str, RobotVehicle] = {}
        stack.callback(lambda: _close_all(vehicles, wire.clock.now_ns()))
        should_stop.ready()
        print_result(f"{who}: team {team} at {broker.host}:{broker.port}, as {shown.topic('')}")
        for _ in steps(should_stop, PERIOD_S):
            tokens.changes()
            there = {names["robot"] for names in tokens.present.values()}
            for received in inbox.drain():
                name = received.message.robot
                if name not in vehicles and name in there and len(vehicles) < ROBOTS_MAX:
                    vehicles[name] = RobotVehicle(shown._replace(serial=name), broker, calls, file, wire)
                if name in vehicles and received.topic is ROBOT_STATE:
                    vehicles[name].state = received.message
                elif name in vehicles:
                    vehicles[name].path = received.message
            for name in vehicles.keys() - there:
                vehicles.pop(name).close(wire.clock.now_ns())
            for received in events.drain():
                event = received.message
                for vehicle in vehicles.values():
                    vehicle.orders.record(event.task.id, event.state, event.why)
            for vehicle in vehicles.values():
                vehicle.step(wire.clock.now_ns())
