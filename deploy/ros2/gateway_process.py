"""`robrain ros2 gateway`: shows a team to ROS 2, by rclpy or over Zenoh, and passes orders from there to it."""

import math
import re
from collections.abc import Callable
from contextlib import ExitStack, closing
from typing import Any, NamedTuple, TypeVar

import msgspec
import numpy as np

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid as Grid
from robrain.client.asker import Asker, Then
from robrain.client.team import Team
from robrain.deploy.command_line.output import print_result
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.live_process import LiveStop, SendTimes, open_when_there, wire_when_there
from robrain.protocol.clock import steps, to_ns
from robrain.protocol.errors import RobrainError
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP, ROBOT_MAP_WHOLE
from robrain.protocol.messages.robots import robot_messages
from robrain.protocol.messages.robots.robot_messages import BatteryState, PlannedPath, RobotState
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT, TaskEvent
from robrain.protocol.messages.team.arena_messages import ARENA_SCAN, Scan
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.map_frame import ARENA
from robrain.protocol.ros2 import message_types as ros
from robrain.protocol.ros2.message_types import (
    MarkerArray,
    MessageType,
    String,
    SubmitTaskResponse,
    TFMessage,
    TriggerResponse,
)
from robrain.protocol.ros2.qos import LATCHED, RELIABLE, SENSOR_DATA, TF, Qos
from robrain.protocol.ros2.ros_names import environment_domain
from robrain.protocol.ros2.ros_node import RosNode
from robrain.protocol.ros2.ros_port import PendingRequest, RosPort, Writer
from robrain.protocol.wire.endpoint import Endpoint
from robrain.recording.drawing.palette import FRONTIER, HALTED, LOST, WARNING, Rgb, style_of
from robrain.recording.drawing.recorded_map import KnownMap

M = TypeVar("M")

SECOND_NS = 1_000_000_000
STAMP_MAX_S = 2**31 - 1
"""Of ROS 2's time."""
ROBOT_HEIGHT_M = 0.25
LABEL_M = 0.25
CYLINDER, SPHERE, TEXT, DELETE_ALL = 3, 2, 9, 3
"""Of `visualization_msgs/msg/Marker`: types, and the action that removes drawn markers."""
CHARGING, DISCHARGING, GOOD = 1, 2, 1
"""Of `sensor_msgs/msg/BatteryState`."""
MARKERS_MAX = 4096


def base_frame(robot: str) -> str:
    """Frame of a robot's body (REP 105), with the robot's name before it."""
    return f"{robot}/base_link"


def stamped(kind: MessageType[M], frame: str, stamp_ns: int, **values: Any) -> M:
    """A blank message whose header has a frame and a stamp."""
    message: Any = kind.blank(**values)
    message.header.frame_id = frame
    _set_time(message.header.stamp, stamp_ns)
    found: M = message
    return found


def occupancy_grid(grid: Grid, frame: str, stamp_ns: int) -> ros.OccupancyGrid:
    """The map: −1 unknown, 0 free, 100 occupied, rows from the lowest y, as ROS 2 has them too."""
    geometry = grid.geometry
    message = stamped(ros.OCCUPANCY_GRID, frame, stamp_ns, data=grid.classes().ravel())
    message.info.resolution = geometry.resolution_m
    message.info.width, message.info.height = geometry.width, geometry.height
    _set_time(message.info.map_load_time, stamp_ns)
    _place(message.info.origin, Pose2D(geometry.origin_x_m, geometry.origin_y_m, 0.0))
    return message


def pose_stamped(pose: Pose2D, frame: str, stamp_ns: int) -> ros.PoseStamped:
    """Pose of a robot."""
    message = stamped(ros.POSE_STAMPED, frame, stamp_ns)
    _place(message.pose, pose)
    return message


def transform(robot: str, pose: Pose2D, frame: str, stamp_ns: int) -> Any:
    """From the map to a robot's body."""
    message = stamped(ros.TRANSFORM_STAMPED, frame, stamp_ns, child_frame_id=base_frame(robot))
    moved = message.transform
    moved.translation.x, moved.translation.y = pose.x_m, pose.y_m
    moved.rotation.z, moved.rotation.w = math.sin(pose.yaw_rad / 2), math.cos(pose.yaw_rad / 2)
    return message


def path(planned: PlannedPath, frame: str) -> ros.Path:
    """A robot's path; each pose faces the next point."""
    message = stamped(ros.PATH, frame, planned.stamp_ns)
    yaw_rad = 0.0
    for point, after in zip(planned.points, [*planned.points[1:], None], strict=False):
        if after is not None:
            yaw_rad = math.atan2(after.y_m - point.y_m, after.x_m - point.x_m)
        pose = stamped(ros.POSE_STAMPED, frame, planned.stamp_ns)
        _place(pose.pose, Pose2D(point.x_m, point.y_m, yaw_rad))
        message.poses.append(pose)
    return message


def laser_scan(scan: Scan) -> ros.LaserScan:
    """A turn of a lidar, in the robot's frame; no return is infinite (REP 117)."""
    ranges_m = np.array(scan.ranges_mm, np.float32) / np.float32(1000.0)
    ranges_m[ranges_m == 0] = np.inf
    return stamped(
        ros.LASER_SCAN,
        base_frame(scan.robot),
        scan.stamp_ns,
        angle_min=scan.angle_min_rad,
        angle_max=scan.angle_min_rad + scan.angle_increment_rad * max(len(ranges_m) - 1, 0),
        angle_increment=scan.angle_increment_rad,
        range_max=scan.range_max_m,
        ranges=ranges_m,
    )


def battery_message(robot: str, state: BatteryState, stamp_ns: int) -> ros.BatteryState:
    """A battery_message; its current is negative while it discharges, and a missing measurement is NaN."""
    return stamped(
        ros.BATTERY_STATE,
        base_frame(robot),
        stamp_ns,
        voltage=state.voltage_v,
        current=-state.current_a,
        temperature=state.temperature_c,
        charge=math.nan,
        capacity=math.nan,
        design_capacity=math.nan,
        percentage=state.soc,
        power_supply_status=CHARGING if state.charging else DISCHARGING,
        power_supply_health=GOOD if not state.implausible else 0,
        present=True,
    )


def markers(states: dict[str, RobotState], tasks: dict[str, TaskEvent], frame: str, stamp_ns: int) -> MarkerArray:
    """All robots (footprint and name) and open tasks; the first marker removes those drawn before.

    Args:
        states: by the robots' names in ROS 2.
        tasks: open ones, by their ids.
        frame: name of the arena frame.
        stamp_ns: since 1970.

    """
    drawn: list[Any] = [stamped(ros.MARKER, frame, stamp_ns, action=DELETE_ALL)]
    for index, (robot, state) in enumerate(states.items()):
        radius_m = state.radius_m or 0.2
        body = HALTED if state.halted else LOST if state.lost else style_of(index).color
        word = " halted" if state.halted else " lost" if state.lost else ""
        where = base_frame(robot)
        size = (2 * radius_m, 2 * radius_m, ROBOT_HEIGHT_M)
        drawn.append(_marker("robots", index, where, CYLINDER, size, body, (0.0, 0.0, ROBOT_HEIGHT_M / 2)))
        above = (0.0, 0.0, ROBOT_HEIGHT_M + LABEL_M)
        drawn.append(_marker("names", index, where, TEXT, (0.0, 0.0, LABEL_M), body, above, state.robot + word))
    for index, event in enumerate(tasks.values()):
        at, color = event.task.place, FRONTIER if event.robot else WARNING
        size = (0.2, 0.2, 0.2)
        drawn.append(_marker("tasks", index, frame, SPHERE, size, color, (at.x_m, at.y_m, 0.1)))
        text = f"{event.task.kind} {event.task.id} {event.state}"
        drawn.append(_marker("task names", index, frame, TEXT, (0.0, 0.0, LABEL_M), color, (at.x_m, at.y_m, 0.5), text))
    return MarkerArray(drawn[:MARKERS_MAX])


def _marker(
    group: str,
    number: int,
    frame: str,
    shape: int,
    size_m: tuple[float, float, float],
    rgb: Rgb,
    at_m: tuple[float, float, float],
    text: str = "",
) -> ros.Marker:
    """A marker that stays at its frame, at any time."""
    marker = stamped(ros.MARKER, frame, 0, ns=group, id=number, type=shape, text=text, frame_locked=True)
    marker.scale.x, marker.scale.y, marker.scale.z = size_m
    marker.pose.position.x, marker.pose.position.y, marker.pose.position.z = at_m
    marker.pose.orientation.w = 1.0
    marker.color.r, marker.color.g, marker.color.b = (part / 255 for part in rgb)
    marker.color.a = 1.0
    return marker


def _place(message: ros.Pose, pose: Pose2D) -> None:
    message.position.x, message.position.y = pose.x_m, pose.y_m
    message.orientation.z, message.orientation.w = math.sin(pose.yaw_rad / 2), math.cos(pose.yaw_rad / 2)


def _set_time(stamp: Any, stamp_ns: int) -> None:
    stamp.sec, stamp.nanosec = min(max(stamp_ns, 0) // SECOND_NS, STAMP_MAX_S), max(stamp_ns, 0) % SECOND_NS


MAP_NS = to_ns(1.0)
MARKERS_NS = to_ns(0.5)
INBOX_CAPACITY = 4096
ROBOTS_MAX = 256
TASKS_MAX = 1024
"""Open tasks that are drawn."""
MAP_FRAME = "map"
"""The arena frame, as REP 105 calls it."""
_NOT_A_WORD = re.compile(r"[^A-Za-z0-9_]")

R = TypeVar("R")


TEXT_MAX = 65_536
"""Characters of a task."""


class OrderOutcome(NamedTuple):
    """Outcome of an order."""

    accepted: bool
    text: str
    """The task as JSON, the robots that have stopped, or why not."""


class AskedTask(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A task as ROS 2 nodes submit it; the fields are those of `Team.submit`."""

    kind: str
    id: str | None = None
    place: tuple[float, float] | None = None
    priority: float | None = None
    earliest_s: float | None = None
    deadline_s: float | None = None
    service_s: float | None = None
    needs: list[str] = []
    after: list[str] = []
    robots: int | None = None
    parameters: dict[str, Any] = {}


class TeamOrders:
    """Orders to a live team.

    Args:
        connect: makes a client of the team; called twice, since a halt must not wait for a task.
        by: name in the records of tasks and halts.

    """

    def __init__(self, connect: Callable[[], Team], by: str) -> None:
        self._by = by
        self._tasks, self._halts = connect(), connect()
        self._submitting, self._halting = Asker(None, workers=1), Asker(None, workers=1)

    def submit(self, text: str, then: Then[OrderOutcome]) -> None:
        """Submit a task, given as JSON."""
        self._submitting.call(lambda: submit(self._tasks, text), then)

    def halt(self, then: Then[OrderOutcome]) -> None:
        """Halt all robots."""
        self._halting.call(lambda: halt(self._halts, self._by), then)

    def deliver(self) -> None:
        """Hand over the outcomes that have arrived."""
        self._submitting.deliver()
        self._halting.deliver()

    def close(self) -> None:
        """End, without the orders that have not begun."""
        for part in (self._submitting, self._halting, self._tasks, self._halts):
            part.close()


def submit(team: Team, text: str) -> OrderOutcome:
    """Submit a task that is given as JSON; waits for the coordinator."""
    if len(text) > TEXT_MAX:
        return OrderOutcome(False, f"expected a task of at most {TEXT_MAX} characters, got {len(text)}")
    try:
        asked = msgspec.json.decode(text, type=AskedTask)
        fields = {name: getattr(asked, name) for name in asked.__struct_fields__ if name != "kind"}
        return OrderOutcome(True, msgspec.json.encode(team.submit(asked.kind, **fields)).decode())
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        return OrderOutcome(False, f'expected a task as JSON, such as {{"kind": "visit", "place": [1, 2]}}: {error}')
    except RobrainError as error:
        return OrderOutcome(False, str(error))


def halt(team: Team, by: str) -> OrderOutcome:
    """Halt all robots; waits until they have stopped, or for two seconds."""
    try:
        report = team.halt(reason="asked by a ROS 2 node", by=by)
    except RobrainError as error:
        return OrderOutcome(False, str(error))
    lines = [f"{robot}: halted" for robot in report.confirmed]
    lines += [f"{robot}: NOT halted: {reason}" for robot, reason in report.unconfirmed.items()]
    return OrderOutcome(not report.unconfirmed, "; ".join(lines))


class Gateway:
    """Shows a team to ROS 2.

    Args:
        wire: of the team; its owner closes it, after the gateway.
        port: the node of ROS 2; its owner closes it.
        orders: receiver of tasks and halts; None for none.
        map_frame: name of the arena frame in ROS 2.

    """

    def __init__(self, wire: Endpoint, port: RosPort, orders: TeamOrders | None, *, map_frame: str = MAP_FRAME) -> None:
        self.left_out = 0
        """Messages of robots beyond `ROBOTS_MAX`, or with a name that another has in ROS 2."""
        self._wire = wire
        self._port = port
        self._orders = orders
        self._frame = map_frame
        self._inbox, self._maps = Inbox(INBOX_CAPACITY), Inbox(INBOX_CAPACITY, every=True)
        self._known_map = KnownMap()
        self._words: dict[str, str] = {}
        self._writers: dict[str, Writer[Any]] = {}
        self._states: dict[str, RobotState] = {}
        self._tasks: dict[str, TaskEvent] = {}
        self._times = SendTimes()
        if orders is not None:
            self._submissions = port.serve("submit_task", ros.SUBMIT_TASK)
            self._texts = port.subscribe("submit_task", ros.STRING)
            self._halts = port.serve("halt", ros.TRIGGER)
        for topic in (robot_messages.ROBOT_STATE, robot_messages.ROBOT_PATH, ARENA_SCAN, TASK_EVENT):
            wire.subscribe(self._inbox, topic)
        wire.subscribe(self._maps, ROBOT_MAP)

    def step(self) -> None:
        """Show new messages, and answer requests."""
        now_ns = self._wire.clock.now_ns()
        if self._orders is not None:
            self._answer(self._orders)
        self._show(now_ns)
        self._show_map(now_ns)
        if self._times.is_due("markers", MARKERS_NS, now_ns):
            shown = markers(self._states, self._tasks, self._frame, now_ns)
            self._write("markers", ros.MARKER_ARRAY, LATCHED, shown)

    # -- output -------------------------------------------------------------------------------------------------

    def _show(self, now_ns: int) -> None:
        moved = []
        for received in self._inbox.drain():
            message, topic = received.message, received.topic
            if topic is TASK_EVENT:
                self._handle_task(message)
            elif (word := self._word(message.robot)) is None:
                self.left_out += 1
            elif topic is robot_messages.ROBOT_STATE:
                self._handle_state(message, word)
                if _is_placed(message):
                    moved.append(transform(word, message.pose, self._frame, message.stamp_ns or now_ns))
            elif topic is robot_messages.ROBOT_PATH:
                self._write(f"{word}/path", ros.PATH, LATCHED, path(message, self._frame))
            elif topic is ARENA_SCAN:
                scan = laser_scan(message)
                scan.header.frame_id = base_frame(word)
                self._write(f"{word}/scan", ros.LASER_SCAN, SENSOR_DATA, scan)
        if moved:
            self._write("/tf", ros.TF_MESSAGE, TF, TFMessage(moved))

    def _handle_state(self, state: RobotState, word: str) -> None:
        if word not in self._states:  # patches have changes only
            self._wire.ask_into(self._maps, ROBOT_MAP_WHOLE, ROBOT_MAP, robot=state.robot)
        self._states[word] = state
        if state.pose is not None and _is_placed(state):
            pose = pose_stamped(state.pose, self._frame, state.stamp_ns)
            self._write(f"{word}/pose", ros.POSE_STAMPED, RELIABLE, pose)
        if state.battery is not None:
            battery = battery_message(word, state.battery, state.stamp_ns)
            self._write(f"{word}/battery", ros.BATTERY_STATE, RELIABLE, battery)

    def _handle_task(self, event: TaskEvent) -> None:
        self._write("task_events", ros.STRING, RELIABLE, String(msgspec.json.encode(event).decode()))
        self._tasks.pop(event.task.id, None)
        if not event.state.ended and len(self._tasks) < TASKS_MAX:
            self._tasks[event.task.id] = event

    def _show_map(self, now_ns: int) -> None:
        for _, _, payload in self._maps.drain_raw():
            self._known_map.handle(payload)
        if self._known_map.has_news and self._times.is_due("map", MAP_NS, now_ns):
            grid = self._known_map.merged().grid
            if grid is not None:
                self._write("map", ros.OCCUPANCY_GRID, LATCHED, occupancy_grid(grid, self._frame, now_ns))

    def _write(self, topic: str, kind: MessageType[M], qos: Qos, message: M) -> None:
        writer = self._writers.get(topic)
        if writer is None:
            writer = self._writers[topic] = self._port.advertise(topic, kind, qos)
        writer.publish(message)

    def _word(self, robot: str) -> str | None:
        """A robot's name as names of ROS 2 have it; None if another robot has it, or there are too many."""
        word = self._words.get(robot)
        if word is None:
            word = _NOT_A_WORD.sub("_", robot)
            word = f"_{word}" if word[:1].isdigit() else word
            if len(self._words) >= ROBOTS_MAX or word in self._words.values():
                return None
            self._words[robot] = word
        return word

    # -- requests -----------------------------------------------------------------------------------------------

    def _answer(self, orders: TeamOrders) -> None:
        for halt in self._halts.requests():
            orders.halt(_reply(halt, TriggerResponse))
        for asked in self._submissions.requests():
            orders.submit(asked.request.task, _reply(asked, SubmitTaskResponse))
        for received in self._texts.read():
            orders.submit(received.message.data, self._reply_all)
        orders.deliver()

    def _reply_all(self, found: OrderOutcome | None, why: str) -> None:
        accepted, answer = found or (False, why)
        text = msgspec.json.encode({"accepted": accepted, "answer": answer}).decode()
        self._write("task_answers", ros.STRING, RELIABLE, String(text))


def _is_placed(state: RobotState) -> bool:
    """Whether a robot knows its pose in the arena frame."""
    return state.pose is not None and state.frame == ARENA and not state.lost


def _reply(request: PendingRequest[Any, R], response: Callable[[bool, str], R]) -> Then[OrderOutcome]:
    return lambda found, why: request.reply(response(*(found or (False, why))))


PERIOD_S = 0.05
NODE, BY, NAMESPACE = "gateway", "ros2", "/robrain"
NAME = "ros2 gateway"
PATIENCE_S = 3.0
"""Timeout of a caller for a coordinator that does not answer."""


def gateway_command(
    connect: str | None,
    team: str,
    *,
    domain_id: int | None,
    frame: str,
    read_only: bool,
    over_zenoh: bool,
    router: str | None,
) -> None:
    """Run the gateway until Ctrl-C; wait until the endpoints answer.

    Args:
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.
        domain_id: ROS domain; None uses $ROS_DOMAIN_ID, else 0.
        frame: name of the team's frame in ROS.
        read_only: accept no orders.
        over_zenoh: speak to nodes on rmw_zenoh, without ROS; else by rclpy.
        router: with `over_zenoh`, endpoint of the nodes' Zenoh router; None is that of the team.

    Raises:
        RobrainError: in one sentence.

    """
    should_stop = LiveStop()
    try:
        domain = environment_domain() if domain_id is None else domain_id
    except ValueError as error:
        raise UsageError(str(error)) from error
    with ExitStack() as stack:
        wire = stack.enter_context(wire_when_there(NAME, connect, team, should_stop))
        if wire is None:
            return
        if over_zenoh:
            nodes = wire.session if router is None else open_when_there(NAME, (router,), should_stop)
            if nodes is None:
                return
            stack.enter_context(closing(nodes))
            failure: Callable[[], str] = str  # it has none
            port: RosPort = RosNode(nodes, NODE, namespace=NAMESPACE, domain=domain, now_ns=wire.clock.now_ns)
        else:
            port, failure = _rclpy_port(domain)
        stack.enter_context(closing(port))
        orders = None
        if not read_only:
            orders = stack.enter_context(
                closing(TeamOrders(lambda: Team.connect(connect, team=team, by=BY, patience_s=PATIENCE_S), BY))
            )
        shown = Gateway(wire, port, orders, map_frame=frame)
        should_stop.ready()
        accepted = "no orders are taken" if read_only else f"orders: {NAMESPACE}/submit_task, {NAMESPACE}/halt"
        print_result(f"{NAME}: team {team} in ROS domain {domain}; {accepted}")
        for _ in steps(lambda: should_stop() or bool(failure()), PERIOD_S):
            shown.step()


def _rclpy_port(domain: int) -> tuple[RosPort, Callable[[], str]]:
    from robrain.deploy.ros2.rclpy_port import RclpyPort  # it needs rclpy

    port = RclpyPort(domain, NAMESPACE)
    return port, lambda: port.failure
