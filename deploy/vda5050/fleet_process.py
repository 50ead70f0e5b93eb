"""`robrain vda5050 fleet`: a VDA 5050 master sees the robots of a team as vehicles, and gives them orders."""

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import msgspec

from robrain.client.team import Team
from robrain.deploy.command_line.options import make_folder
from robrain.deploy.command_line.output import print_result
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.live_process import LiveStop, live_endpoint, open_when_there
from robrain.deploy.vda5050.factsheet import factsheet
from robrain.deploy.vda5050.messages import (
    Action,
    ActionStatus,
    BadMessage,
    Body,
    Connection,
    ConnectionState,
    ControlPoint,
    InstantActions,
    MapPlace,
    Nurbs,
    OperatingMode,
    Order,
    PlannedTrajectory,
    Polyline,
    Position,
    PowerSupply,
    SafetyState,
    State,
    Vehicle,
    Velocity,
    Version,
    Visualization,
    Waypoint,
    read,
    timestamp,
)
from robrain.deploy.vda5050.mqtt_link import Broker, MqttLink, Packet
from robrain.deploy.vda5050.robot_orders import KeptOrder, NodeTask, RobotOrders
from robrain.protocol.clock import Clock, steps, to_ns
from robrain.protocol.errors import CallError, NobodyThere, RobrainError
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import (
    ROBOT_ALIVE,
    ROBOT_PATH,
    ROBOT_STATE,
    PlannedPath,
    RobotState,
)
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT
from robrain.protocol.model.tasks.stock_kinds import VISIT
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.refusals import RefusalCode, Refusals
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
        after = [task.after] if task.after else []
        try:
            record = self._tasks.submit(
                VISIT, id=task.id, place=task.place, service_s=task.service_s, needs=[robot], after=after
            )
        except CallError as error:  # the coordinator refuses it for good
            return TaskState.FAILED, str(error)
        return record.state, record.why

    def _cancel(self, task_id: str) -> tuple[TaskState, str]:
        try:
            record = self._tasks.cancel(task_id, why="cancelOrder")
        except CallError:
            return self._get(task_id)
        return record.state, record.why

    def _get(self, task_id: str) -> tuple[TaskState, str]:
        try:
            record = self._tasks.get(task_id)
        except CallError as error:
            return TaskState.CANCELLED, str(error)
        return record.state, record.why

    def _halt(self, robot: str, halted: bool) -> str:
        order = self._halts.halt if halted else self._halts.resume
        try:
            return "; ".join(order(robot, by=BY).unconfirmed.values())
        except (CallError, NobodyThere) as error:
            return str(error)


class RobotVehicle:
    """A robot as a vehicle on MQTT.

    Args:
        vehicle: its address.
        robot: its name.
        broker: where it is shown.
        place: of the vehicles' map.
        orders: its orders.
        calls: passes tasks and halts on.
        file: keeps the order.
        clock: stamps messages.
        refusals: counts messages that cannot be read.

    """

    def __init__(
        self,
        vehicle: Vehicle,
        robot: str,
        broker: Broker,
        place: MapPlace,
        calls: TeamCalls,
        file: OrderFile,
        clock: Clock,
        refusals: Refusals,
    ) -> None:
        self.state: RobotState | None = None
        self.path: PlannedPath | None = None
        self.orders = RobotOrders(robot, vehicle.version, place, file.read(robot))
        self._vehicle, self._robot, self._place, self._calls, self._file = vehicle, robot, place, calls, file
        self._clock, self._refusals = clock, refusals
        self._waiting: dict[str, Future[tuple[TaskState, str]]] = {}
        self._halting: list[tuple[Action, Future[str]]] = []
        self._header_ids: dict[str, int] = {}
        self._sent_ns: dict[str, int] = {}
        self._last: bytes = b""
        self._connections = 0
        broken = Connection(ConnectionState.broken(vehicle.version))
        will = Packet(vehicle.topic("connection"), vehicle.payload(broken, 0, clock.now_ns()), 1, True)
        topics = [vehicle.topic("order"), vehicle.topic("instantActions")]
        self._mqtt = MqttLink(broker, f"robrain-{vehicle.manufacturer}-{vehicle.serial}", topics, will)

    def step(self, now_ns: int) -> None:
        """Process messages, call the team, and publish."""
        if self._mqtt.connections != self._connections:
            self._connections = self._mqtt.connections
            self._publish("connection", Connection(ConnectionState.ONLINE), now_ns)
            self._publish("factsheet", factsheet(self._vehicle.version, self.state), now_ns)
        for packet in self._mqtt.drain():
            self._handle(packet, now_ns)
        self._call_team(now_ns)
        self._publish_state(now_ns)

    def close(self) -> None:
        """Report the vehicle as offline, and disconnect."""
        self._publish("connection", Connection(ConnectionState.OFFLINE), self._clock.now_ns())
        self._mqtt.close()

    def _handle(self, packet: Packet, now_ns: int) -> None:
        try:
            if packet.topic == self._vehicle.topic("order"):
                order = read(packet.topic, packet.payload, Order)
                if self.orders.handle_order(order, packet.payload, self.state):
                    self._file.write(self._robot, self.orders.kept)
            else:
                for action in read(packet.topic, packet.payload, InstantActions).actions:
                    self._do(action, now_ns)
        except BadMessage as error:
            self._refusals.record("vda5050", packet.topic, RefusalCode.MALFORMED, str(error))
            self.orders.reject_payload(str(error))
        self._last = b""

    def _do(self, action: Action, now_ns: int) -> None:
        orders = self.orders
        if action.action_id in orders.instant:
            return  # it has come twice
        match action.action_type:
            case "cancelOrder":
                if orders.cancel(action):
                    self._file.write(self._robot, orders.kept)
            case "startPause" | "stopPause" if len(self._halting) < CALLS_MAX:
                orders.set_instant(action, ActionStatus.RUNNING)
                is_start = action.action_type == "startPause"
                self._halting.append((action, self._calls.halt(self._robot, halted=is_start)))
            case "stateRequest":
                orders.set_instant(action, ActionStatus.FINISHED)
            case "factsheetRequest":
                self._publish("factsheet", factsheet(self._vehicle.version, self.state), now_ns)
                orders.set_instant(action, ActionStatus.FINISHED)
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
                orders.set_instant(action, ActionStatus.FAILED if halt.result() else ActionStatus.FINISHED)
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
                waiting[task.id] = self._calls.submit(task, self._robot)
        opened = orders.open_task()
        if is_due and opened is not None and opened.id not in waiting:
            waiting[opened.id] = self._calls.get(opened.id)

    def _publish_state(self, now_ns: int) -> None:
        robot, orders, is_old = self.state, self.orders, self._vehicle.version is Version.V2_1
        if robot is None:
            return
        pose = robot.pose if robot.pose is not None and not robot.lost else None
        where = self._position(robot)
        velocity = Velocity(robot.velocity.forward_m_s, robot.velocity.left_m_s, robot.velocity.yaw_rad_s)
        instant, actions = list(orders.instant.values()), orders.action_states(pose)
        reached, nodes = orders.reached, orders.node_states()
        state = State(
            order_id=orders.kept.order_id,
            order_update_id=orders.kept.order_update_id,
            last_node_id="" if reached is None else reached.node_id,
            last_node_sequence_id=0 if reached is None else reached.sequence_id,
            node_states=nodes,
            edge_states=orders.edge_states(),
            driving=any((velocity.vx, velocity.vy, velocity.omega)),
            operating_mode=OperatingMode.AUTOMATIC,
            action_states=actions + instant if is_old else actions,
            errors=orders.errors(),
            safety_state=SafetyState(False, e_stop="NONE")
            if is_old
            else SafetyState(False, active_emergency_stop="NONE"),
            paused=robot.halted,
            instant_action_states=msgspec.UNSET if is_old else instant,
        )
        if is_old:
            state.battery_state, state.safety_state.e_stop = _power(robot, is_old), "NONE"
        else:
            state.power_supply, state.safety_state.active_emergency_stop = _power(robot, is_old), "NONE"
        news = msgspec.json.encode(state)
        is_new = news != self._last and self._is_due("news", STATE_LEAST_NS, now_ns)
        moving: dict[str, Any] = {"agv_position" if is_old else "mobile_robot_position": where, "velocity": velocity}
        if not is_old:
            moving |= _paths(self._place, self.path, robot, now_ns)
        if is_new or self._is_due("state", STATE_NS, now_ns):
            self._last, self._sent_ns["state"] = news, now_ns
            for name, value in moving.items():
                setattr(state, name, value)
            self._publish("state", state, now_ns)
        if self._is_due("visualization", VISUALIZATION_NS, now_ns):
            shown = Visualization(**moving)
            if not is_old:
                shown.reference_state_header_id = self._header_ids.get("state", 0)
            self._publish("visualization", shown, now_ns)

    def _position(self, robot: RobotState) -> Position | msgspec.UnsetType:
        if robot.pose is None:
            return msgspec.UNSET
        at, known = self._place.from_arena(robot.pose.x_m, robot.pose.y_m, robot.pose.yaw_rad), not robot.lost
        found = Position(at.x_m, at.y_m, at.yaw_rad, self._place.map_id)
        if self._vehicle.version is Version.V2_1:
            found.position_initialized = known
        else:
            found.localized = known
        return found

    def _publish(self, name: str, body: Body | dict[str, Any], now_ns: int) -> None:
        self._header_ids[name] = self._header_ids.get(name, -1) + 1
        payload = self._vehicle.payload(body, self._header_ids[name], now_ns)
        is_connection = name == "connection"
        self._mqtt.publish(self._vehicle.topic(name), payload, int(is_connection), is_retained=is_connection)

    def _is_due(self, what: str, period_ns: int, now_ns: int) -> bool:
        if now_ns - self._sent_ns.get(what, -period_ns) < period_ns:
            return False
        self._sent_ns[what] = now_ns
        return True


def _power(robot: RobotState, is_old: bool) -> PowerSupply:
    battery = robot.battery
    percent = 100.0 if battery is None else min(max(100.0 * battery.soc, 0.0), 100.0)
    found = PowerSupply(charging=battery is not None and battery.charging)
    if is_old:
        found.battery_charge = percent
    else:
        found.state_of_charge = percent
    return found


def _paths(place: MapPlace, path: PlannedPath | None, robot: RobotState, now_ns: int) -> dict[str, Any]:
    """The robot's planned path as both paths of version 3; empty while it stands."""
    if path is None or len(path.points) < 2 or robot.pose is None:
        return {}
    points = [place.from_arena(point.x_m, point.y_m) for point in path.points[:WAYPOINTS_MAX]]
    speed_m_s, along_m, waypoints = path.speed_m_s or 0.5, 0.0, []
    for before, at in zip([points[0], *points], points, strict=False):
        along_m += before.distance_m(at)
        waypoints.append(Waypoint(at.x_m, at.y_m, timestamp(now_ns + to_ns(along_m / speed_m_s))))
    last = len(points) - 1
    knots = [0.0, *(number / last for number in range(last + 1)), 1.0]
    curve = Nurbs(1, knots, [ControlPoint(at.x_m, at.y_m) for at in points])
    return {"planned_path": PlannedTrajectory(curve), "intermediate_path": Polyline(waypoints)}


def _close_all(vehicles: dict[str, RobotVehicle]) -> None:
    while vehicles:
        vehicles.popitem()[1].close()


def fleet_command(
    connect: str | None, team: str, broker: Broker, version: Version, manufacturer: str, place: MapPlace, folder: Path
) -> None:
    """Show a team's robots as vehicles until Ctrl-C; wait until the endpoints answer.

    Args:
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.
        broker: of MQTT.
        version: of VDA 5050.
        manufacturer: of all vehicles; their serial numbers are the robots' names.
        place: of the vehicles' map.
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
        stack.callback(lambda: _close_all(vehicles))
        should_stop.ready()
        print_result(f"{who}: team {team} at {broker.host}:{broker.port}, as {version.interface}/{manufacturer}/ROBOT")
        for _ in steps(should_stop, PERIOD_S):
            tokens.changes()
            there = {names["robot"] for names in tokens.present.values()}
            for received in inbox.drain():
                name = received.message.robot
                if name not in vehicles and name in there and len(vehicles) < ROBOTS_MAX:
                    address = Vehicle(version, manufacturer, name)
                    vehicles[name] = RobotVehicle(address, name, broker, place, calls, file, wire.clock, wire.refusals)
                if name in vehicles and received.topic is ROBOT_STATE:
                    vehicles[name].state = received.message
                elif name in vehicles:
                    vehicles[name].path = received.message
            for name in vehicles.keys() - there:
                vehicles.pop(name).close()
            for received in events.drain():
                event = received.message
                for vehicle in vehicles.values():
                    vehicle.orders.record(event.task.id, event.state, event.why)
            for vehicle in vehicles.values():
                vehicle.step(wire.clock.now_ns())
