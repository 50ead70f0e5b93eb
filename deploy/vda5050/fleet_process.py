"""`robrain vda5050 fleet`: a VDA 5050 master sees the robots of a team as vehicles, and gives them orders."""

import math
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from robrain.client.asker import Asker
from robrain.client.halting import HaltReport, order_robot
from robrain.deploy.command_line.options import make_folder, write_file
from robrain.deploy.command_line.output import print_result
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.live_process import LiveStop, live_endpoint, open_when_there
from robrain.deploy.vda5050 import messages as vda
from robrain.deploy.vda5050.mqtt_link import Broker, MqttLink
from robrain.deploy.vda5050.robot_orders import KeptOrder, RobotOrders
from robrain.protocol.clock import steps, to_ns
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots import robot_messages
from robrain.protocol.messages.robots.robot_messages import PlannedPath, RobotState
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT
from robrain.protocol.messages.tasks.task_messages import (
    TASK_CANCEL,
    TASK_GET,
    TASK_SUBMIT,
    TaskRecord,
    TaskRequest,
    TaskSubmission,
)
from robrain.protocol.messages.team.team_messages import Halt
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.refusals import RefusalCode
from robrain.protocol.topic import Query
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.hub import team_endpoints

PERIOD_S = 0.02
STATE_NS, STATE_LEAST_NS, VISUALIZATION_NS = to_ns(1.0), to_ns(0.05), to_ns(0.5)
CHECK_NS = to_ns(2.0)
"""Period of the query for the state of an open task, in addition to the events."""
WAYPOINTS_MAX = 100
ROBOTS_MAX = 256
BY = "vda5050"
TaskOutcome = tuple[TaskState, str]
"""State of a task, and its reason."""


def read_order(folder: Path, robot: str) -> KeptOrder:
    """The kept order of a robot; a blank one if it has none (UsageError if the file is damaged)."""
    path = folder / f"{robot}.json"
    try:
        return msgspec.json.decode(path.read_bytes(), type=KeptOrder) if path.exists() else KeptOrder()
    except (OSError, msgspec.DecodeError) as error:
        raise UsageError(f"{path}: {error}; move it away, and cancel the robot's tasks") from error


def write_order(folder: Path, robot: str, kept: KeptOrder) -> None:
    """Keep the order of a robot before it is acknowledged; it is on disk when this returns."""
    write_file(folder / f"{robot}.json", msgspec.json.encode(kept))


def ask_coordinator(wire: Endpoint, task: Task, *, is_cancelled: bool) -> TaskOutcome:
    """Submit a task, or cancel it. A task that is refused has failed; a cancelled one that is unknown is cancelled.

    Raises:
        RobrainError: there is no answer.

    """
    asked: Any = TaskSubmission(task=task, by=BY)
    if is_cancelled:
        asked = TaskRequest(id=task.id, by=BY, why="cancelOrder")
    outcome = TaskState.CANCELLED if is_cancelled else TaskState.FAILED, ""
    queries: list[Query[Any, TaskRecord]] = [TASK_CANCEL, TASK_GET] if is_cancelled else [TASK_SUBMIT]
    for query in queries:  # a task that has ended cannot be cancelled
        try:
            record = wire.ask(query, asked)
        except CallError as error:
            if error.code not in (ErrorCode.REFUSED, ErrorCode.BAD_ARGUMENTS):
                raise
            outcome = outcome[0], str(error)
        else:
            return record.state, record.why
    return outcome


class RobotVehicle:
    """A robot as a vehicle on MQTT.

    Args:
        vehicle: its address; its serial number is the robot's name.
        broker: where it is shown.
        folder: keeps the order.
        wire: of the team.
        tasks: asks the coordinator.
        halts: asks robots.

    """

    def __init__(
        self, vehicle: vda.Vehicle, broker: Broker, folder: Path, wire: Endpoint, tasks: Asker, halts: Asker
    ) -> None:
        self.state: RobotState | None = None
        self.path: PlannedPath | None = None
        self.orders = RobotOrders(vehicle, read_order(folder, vehicle.serial))
        self._vehicle, self._folder, self._wire, self._tasks, self._halts = vehicle, folder, wire, tasks, halts
        self._asked: dict[str, bool] = {}
        """Tasks that wait for a reply, and whether there was none: these are asked again."""
        self._times = vda.SendTimes()
        self._last: Any = None
        self._connections = 0
        will = ("connection", {"connectionState": vehicle.words.connection_broken})
        client_id = f"robrain-{vehicle.manufacturer}-{vehicle.serial}"
        self._mqtt = MqttLink(vehicle, broker, client_id, ("order", "instantActions"), wire, will)

    def step(self, now_ns: int) -> None:
        """Process messages, call the team, and publish."""
        if self._mqtt.connections != self._connections:
            self._connections = self._mqtt.connections
            self._mqtt.publish("connection", {"connectionState": "ONLINE"})
            self._mqtt.publish("factsheet", factsheet(self._vehicle, self.state))
        for message, payload in self._mqtt.receive():
            self._handle(message, payload)
        self._ask_team(now_ns)
        if self.state is not None:
            self._publish_state(self.state, now_ns)

    def close(self) -> None:
        """Report the vehicle as offline, and disconnect."""
        self._mqtt.publish("connection", {"connectionState": "OFFLINE"})
        self._mqtt.close()

    def _handle(self, message: vda.VdaStruct | vda.BadVehicleMessage, payload: bytes) -> None:
        self._last = None
        match message:
            case vda.VehicleOrder() as order:
                if self.orders.handle_order(order, payload, self.state):
                    write_order(self._folder, self._vehicle.serial, self.orders.kept)
            case vda.InstantActions(actions=actions):
                for action in actions:
                    if action.action_id not in self.orders.instant:  # else it has come twice
                        self._do(action)
            case error:
                self.orders.reject("VALIDATION_FAILURE", str(error))

    def _do(self, action: vda.OrderAction) -> None:
        orders, serial = self.orders, self._vehicle.serial
        match action.action_type:
            case "cancelOrder":
                if orders.cancel(action):
                    write_order(self._folder, serial, orders.kept)
            case "startPause" | "stopPause" as kind:

                def report(found: HaltReport | None, _error: str) -> None:
                    orders.set_instant(action, "FAILED" if found is None or found.unconfirmed else "FINISHED")

                orders.set_instant(action, "RUNNING")
                wanted = Halt(halted=kind == "startPause", by=BY, reason=kind)
                self._halts.call(lambda: order_robot(self._wire, serial, wanted), report)
            case "stateRequest":
                orders.set_instant(action, "FINISHED")
            case "factsheetRequest":
                self._mqtt.publish("factsheet", factsheet(self._vehicle, self.state))
                orders.set_instant(action, "FINISHED")
            case _:
                orders.refuse_action(action)

    def _ask_team(self, now_ns: int) -> None:
        is_due = self._times.is_due("check", CHECK_NS, now_ns)
        if is_due:
            self._asked = {task_id: False for task_id, has_failed in self._asked.items() if not has_failed}
        ask = partial(ask_coordinator, self._wire, is_cancelled=bool(self.orders.kept.cancelled_by))
        for one in self.orders.to_ask(is_due=is_due):
            if self._asked.keys() & one.task.after:
                break  # the coordinator must know the task before
            if one.task.id not in self._asked:
                self._asked[one.task.id] = False
                self._tasks.call(partial(ask, one.task), partial(self._record, one.task.id))

    def _record(self, task_id: str, found: TaskOutcome | None, error: str) -> None:
        if found is None:  # no coordinator answers
            self._asked[task_id] = True
            self._wire.refusals.record("vda5050", task_id, RefusalCode.LOST, error)
        else:
            del self._asked[task_id]
            self.orders.record(task_id, *found)

    def _publish_state(self, robot: RobotState, now_ns: int) -> None:
        orders, vehicle, speed = self.orders, self._vehicle, robot.velocity
        charging, soc = (False, 1.0) if robot.battery is None else (robot.battery.charging, robot.battery.soc)
        actions, instant = orders.action_states(robot.pose), orders.instant_states()
        reached, (nodes, edges) = orders.reached, orders.remaining
        news: dict[str, Any] = {
            "orderId": orders.kept.order_id,
            "orderUpdateId": orders.kept.order_update_id,
            "lastNodeId": "" if reached is None else reached.node_id,
            "lastNodeSequenceId": 0 if reached is None else reached.sequence_id,
            "nodeStates": [_state_of(node, "node") for node in nodes],
            "edgeStates": [_state_of(edge, "edge") for edge in edges],
            "driving": any(msgspec.structs.astuple(speed)),
            "paused": robot.halted,
            "operatingMode": "AUTOMATIC",
            "errors": orders.errors(),
            "actionStates": actions + instant if vehicle.is_old else actions,
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


def _state_of(part: Any, kind: str) -> dict[str, Any]:
    fields = msgspec.to_builtins(part)
    return {key: fields[key] for key in (f"{kind}Id", "sequenceId", "released")}


def _paths(vehicle: vda.Vehicle, path: PlannedPath | None, now_ns: int) -> dict[str, Any]:
    """The robot's planned path as both paths of version 3; nothing while it stands."""
    if path is None or len(path.points) < 2:
        return {}
    points = [vehicle.waypoint(point.x_m, point.y_m) for point in path.points[:WAYPOINTS_MAX]]
    along_m, last, waypoints = 0.0, len(points) - 1, []
    for before, at in zip([points[0], *points], points, strict=False):
        along_m += math.hypot(at.x - before.x, at.y - before.y)
        eta_ns = now_ns + to_ns(along_m / (path.speed_m_s or SPEED_M_S))
        waypoints.append({"x": at.x, "y": at.y, "eta": vda.timestamp(eta_ns)})
    knots = [0.0, *(number / last for number in range(last + 1)), 1.0]
    curve = {"degree": 1, "knotVector": knots, "controlPoints": points}
    return {"plannedPath": {"trajectory": curve}, "intermediatePath": {"polyline": waypoints}}


SPEED_M_S = 1.0
"""Nominal value, as in `factsheet.json`: a robot does not report it."""


def factsheet(vehicle: vda.Vehicle, robot: RobotState | None) -> dict[str, Any]:
    """The factsheet of a robot as JSON, without its header."""
    sheet: dict[str, Any] = msgspec.json.decode(Path(__file__).with_name("factsheet.json").read_bytes())
    diameter_m = 2.0 * (robot.radius_m if robot is not None else 0.0)
    sheet["physicalParameters"] |= {"width": diameter_m, "length": diameter_m}
    words = vehicle.words
    sheet["typeSpecification"] |= {"mobileRobotKinematics": words.kinematics, "navigationTypes": [words.navigation]}
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
    session = open_when_there(who, team_endpoints(connect), should_stop)
    if session is None:
        return
    with (
        closing(session),
        live_endpoint(session, team) as wire,
        closing(Asker(wire)) as tasks,
        closing(Asker(wire)) as halts,  # they wait for no task
    ):
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
                name = received.message.robot
                if name not in vehicles and name in there and len(vehicles) < ROBOTS_MAX:
                    vehicles[name] = RobotVehicle(shown._replace(serial=name), broker, folder, wire, tasks, halts)
                if name in vehicles and received.topic is robot_messages.ROBOT_STATE:
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
        for vehicle in vehicles.values():
            vehicle.close()
