"""Channels for Foxglove, Lichtblick and Rerun, derived from the recorded topics alone.

`handle` is given each recorded message, and only keeps it; `due` makes messages at rates that keep files small, of the
latest that was kept. The same messages in the same order give the same channels, at the recording or later. Schemas are
those of the package `foxglove-schemas-protobuf`; viewers draw them by name.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple, TypeVar

import msgspec
import numpy as np
from foxglove_schemas_protobuf.ArrowPrimitive_pb2 import ArrowPrimitive
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector2_pb2 import Vector2
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.schema import build_file_descriptor_set
from numpy.typing import NDArray

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.protocol.messages.motes.mote_messages import MOTE_READING, MoteReading
from robrain.protocol.messages.robots.plugin_messages import ROBOT_LOG, LogRecord
from robrain.protocol.messages.robots.robot_messages import ROBOT_PATH, ROBOT_STATE, RobotState
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT, TaskEvent
from robrain.protocol.messages.team.arena_messages import ARENA_SCAN, Scan
from robrain.protocol.messages.team.team_messages import HALT, Halt
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import OCCUPIED as OCCUPIED_CELL
from robrain.protocol.topic import Topic
from robrain.recording.drawing import palette
from robrain.recording.drawing.drawn_map import DrawnFloor
from robrain.recording.drawing.palette import FRONTIER, HALTED, LOST, NOSE, WALL, WARNING, Rgb, mote_color, style_of
from robrain.recording.drawing.recorded_map import KnownMap
from robrain.recording.foxglove import visual_topics
from robrain.recording.foxglove.plain_schema import plain_schema

ARENA = "arena"
"""The fixed frame."""
LAST_STAMP_NS = 2**63 - 1
WALL_HEIGHT_M = 0.5
UNKNOWN_ALPHA = 0
LEVELS = {"debug": Log.DEBUG, "info": Log.INFO, "warning": Log.WARNING, "error": Log.ERROR, "critical": Log.FATAL}


def timestamp(stamp_ns: int) -> Timestamp:
    """Nanoseconds of the run's clock; a value out of protobuf's range becomes the nearest one in it."""
    stamp = Timestamp()
    stamp.FromNanoseconds(min(max(stamp_ns, 0), LAST_STAMP_NS))
    return stamp


def color(rgb: Rgb, alpha: float = 1.0) -> Color:
    """A colour of the palette."""
    red, green, blue = (part / 255 for part in rgb)
    return Color(r=red, g=green, b=blue, a=alpha)


def yaw_quaternion(yaw_rad: float) -> Quaternion:
    """A turn about z."""
    return Quaternion(z=math.sin(yaw_rad / 2), w=math.cos(yaw_rad / 2))


def pose(x_m: float, y_m: float, z_m: float = 0.0, yaw_rad: float = 0.0) -> Pose:
    """A pose on or above the floor."""
    return Pose(position=Vector3(x=x_m, y=y_m, z=z_m), orientation=yaw_quaternion(yaw_rad))


def transforms(poses: Iterable[tuple[str, Pose2D, int]]) -> FrameTransforms:
    """Robots' frames: name, pose and stamp of each."""
    return FrameTransforms(
        transforms=[
            FrameTransform(
                timestamp=timestamp(stamp_ns),
                parent_frame_id=ARENA,
                child_frame_id=robot,
                translation=Vector3(x=at.x_m, y=at.y_m),
                rotation=yaw_quaternion(at.yaw_rad),
            )
            for robot, at, stamp_ns in poses
        ]
    )


def poses_in_frame(points: Sequence[Point2D], stamp_ns: int, z_m: float = 0.02) -> PosesInFrame:
    """Points that are joined to a line."""
    return PosesInFrame(
        timestamp=timestamp(stamp_ns), frame_id=ARENA, poses=[pose(point.x_m, point.y_m, z_m) for point in points]
    )


def laser_scan(scan: Scan, stamp_ns: int) -> LaserScan:
    """A scan in its robot's frame; a beam without a return is beyond the range, as infinity."""
    ranges_m = np.array(scan.ranges_mm, np.float64) / 1000
    ranges_m[ranges_m == 0] = np.inf
    beams = len(ranges_m)
    return LaserScan(
        timestamp=timestamp(stamp_ns),
        frame_id=scan.robot,
        pose=pose(0.0, 0.0, 0.1),
        start_angle=scan.angle_min_rad,
        end_angle=scan.angle_min_rad + scan.angle_increment_rad * max(beams - 1, 0),
        ranges=ranges_m.tolist(),
    )


def scan_points(scan: Scan, stamp_ns: int) -> PointCloud:
    """The hits of a scan as points in the robot's frame, for viewers that do not draw scans."""
    ranges_m = np.array(scan.ranges_mm, np.float32) / 1000
    angles_rad = scan.angle_min_rad + scan.angle_increment_rad * np.arange(len(ranges_m), dtype=np.float32)
    hits = ranges_m > 0
    points = np.full((int(hits.sum()), 3), 0.1, np.float32)
    points[:, 0] = ranges_m[hits] * np.cos(angles_rad[hits])
    points[:, 1] = ranges_m[hits] * np.sin(angles_rad[hits])
    return point_cloud(points, scan.robot, stamp_ns)


def wall_points(grid: OccupancyGrid, stamp_ns: int) -> PointCloud:
    """The middles of the occupied cells, for viewers that draw neither grids nor scenes."""
    rows, columns = np.nonzero(grid.classes() == OCCUPIED_CELL)
    geometry = grid.geometry
    points = np.zeros((len(rows), 3), np.float32)
    points[:, 0] = geometry.origin_x_m + (columns + 0.5) * geometry.resolution_m
    points[:, 1] = geometry.origin_y_m + (rows + 0.5) * geometry.resolution_m
    return point_cloud(points, ARENA, stamp_ns)


def point_cloud(points: NDArray[np.float32], frame: str, stamp_ns: int) -> PointCloud:
    """Points (N, 3), metres, in a frame."""
    fields = [
        PackedElementField(name=name, offset=4 * place, type=PackedElementField.FLOAT32)
        for place, name in enumerate("xyz")
    ]
    return PointCloud(
        timestamp=timestamp(stamp_ns),
        frame_id=frame,
        pose=pose(0.0, 0.0),
        point_stride=12,
        fields=fields,
        data=points.tobytes(),
    )


def map_grid(grid: OccupancyGrid, stamp_ns: int) -> Grid:
    """The known map as colours; unknown cells are transparent."""
    geometry = grid.geometry
    # Classes are −1, 0 and 100; as unsigned bytes 255, 0 and 100.
    colors = np.zeros((256, 4), np.uint8)
    colors[255] = (*palette.UNKNOWN, UNKNOWN_ALPHA)
    colors[0], colors[100] = (*palette.FREE, 255), (*palette.OCCUPIED, 255)
    fields = [
        PackedElementField(name=name, offset=offset, type=PackedElementField.UINT8)
        for offset, name in enumerate(("red", "green", "blue", "alpha"))
    ]
    return Grid(
        timestamp=timestamp(stamp_ns),
        frame_id=ARENA,
        pose=pose(geometry.origin_x_m, geometry.origin_y_m, -0.01),
        column_count=geometry.width,
        cell_size=Vector2(x=geometry.resolution_m, y=geometry.resolution_m),
        row_stride=4 * geometry.width,
        cell_stride=4,
        fields=fields,
        data=colors[grid.classes().view(np.uint8)].tobytes(),
    )


def log(stamp_ns: int, level: str, source: str, text: str) -> Log:
    """One line of a log."""
    return Log(timestamp=timestamp(stamp_ns), level=LEVELS.get(level.lower(), Log.INFO), message=text, name=source)


def point(at: Point2D, z_m: float = 0.0) -> Point3:
    """A point on or above the floor."""
    return Point3(x=at.x_m, y=at.y_m, z=z_m)


Kind = TypeVar("Kind")

TRANSFORMS_NS = to_ns(0.2)
ROBOTS_NS = to_ns(1.0)
SCANS_NS = to_ns(1.0)
MARKS_NS = to_ns(1.0)
"""Motes, tasks, poses, batteries."""
TRAILS_NS = to_ns(5.0)
MAP_NS = to_ns(2.0)
CELLS_A_SECOND = 100_000
"""A large map comes less often: this number of cells a second on average."""
WALLS_NS = to_ns(10.0)
TRAIL_STEP_M = 0.25
TRAIL_POINTS = 200
BATTERY_SCHEMA = "robrain.Battery"
LINES_MAX = 1000
"""Log lines between two calls of `due`."""
LATEST = (ROBOT_STATE, ARENA_SCAN, ROBOT_PATH, MOTE_READING)
"""Topics of which the latest message of each key is drawn."""
LINES = (ROBOT_LOG, TASK_EVENT, HALT)
"""Topics of which each message becomes a log line."""
DRAWN = (*LATEST, *LINES, ROBOT_MAP)
LINE_NAMES = {topic.name for topic in LINES}


ROBOT_HEIGHT_M = 0.25
LABEL_M = 0.35
TEXT: Rgb = (235, 238, 242)


def scene_update(entities: Iterable[SceneEntity], stamp_ns: int) -> SceneUpdate:
    """A message that replaces all before it on its channel."""
    return SceneUpdate(
        deletions=[SceneEntityDeletion(timestamp=timestamp(stamp_ns), type=SceneEntityDeletion.ALL)], entities=entities
    )


def robot_entity(state: RobotState, index: int, stamp_ns: int) -> SceneEntity:
    """A robot in its own frame: footprint, nose and name; `index` chooses its colour."""
    radius_m = state.radius_m or 0.2
    body = HALTED if state.halted else LOST if state.lost else style_of(index).color
    battery = "" if state.battery is None else f" {100 * state.battery.soc:.0f} %"
    entity = _entity(f"robot {state.robot}", state.robot, stamp_ns)
    entity.frame_locked = True
    entity.metadata.extend(
        KeyValuePair(key=key, value=value)
        for key, value in (
            ("behavior", state.behavior),
            ("task", state.task.id if state.task is not None else ""),
            ("halted by", ", ".join(state.halted_by)),
            ("lost", state.lost),
            ("faulted", ", ".join(fault.plugin for fault in state.faulted)),
        )
        if value
    )
    entity.cylinders.append(
        CylinderPrimitive(
            pose=pose(0.0, 0.0, ROBOT_HEIGHT_M / 2),
            size=Vector3(x=2 * radius_m, y=2 * radius_m, z=ROBOT_HEIGHT_M),
            bottom_scale=1.0,
            top_scale=0.9,
            color=color(body),
        )
    )
    entity.arrows.append(
        ArrowPrimitive(
            pose=pose(0.0, 0.0, ROBOT_HEIGHT_M + 0.02),
            shaft_length=radius_m * 0.6,
            shaft_diameter=radius_m * 0.25,
            head_length=radius_m * 0.6,
            head_diameter=radius_m * 0.6,
            color=color(NOSE),
        )
    )
    word = " HALTED" if state.halted else " lost" if state.lost else ""
    entity.texts.append(_label(f"{state.robot}{battery}{word}", ROBOT_HEIGHT_M + 0.35))
    return entity


def mote_entity(reading: MoteReading, stamp_ns: int) -> SceneEntity | None:
    """A mote with its latest reading; None where its place is not known."""
    if reading.place is None:
        return None
    at = reading.place
    entity = _entity(f"mote {reading.mote}", ARENA, stamp_ns)
    entity.spheres.append(
        SpherePrimitive(
            pose=pose(at.x_m, at.y_m, 0.12),
            size=Vector3(x=0.24, y=0.24, z=0.24),
            color=color(mote_color(reading.voltage_v)),
        )
    )
    text = f"{reading.mote} {reading.value:.1f} {reading.quantity}"
    entity.texts.append(_label(text, 0.45, at.x_m, at.y_m, size_m=0.2))
    return entity


def task_entity(event: TaskEvent, stamp_ns: int) -> SceneEntity:
    """An open task: a flag at its place."""
    at = event.task.place
    entity = _entity(f"task {event.task.id}", ARENA, stamp_ns)
    mast = LinePrimitive(
        type=LinePrimitive.LINE_STRIP,
        pose=pose(0.0, 0.0),
        thickness=3.0,
        scale_invariant=True,
        points=[point(at), point(at, 0.6)],
        color=color(FRONTIER if event.robot else WARNING),
    )
    entity.lines.append(mast)
    holder = f" {event.robot}" if event.robot else ""
    kind = "" if event.task.id.startswith(event.task.kind) else f"{event.task.kind} "
    text = f"{kind}{event.task.id} {event.state.replace('_', ' ')}{holder}"
    entity.texts.append(_label(text, 0.75, at.x_m, at.y_m, size_m=0.22))
    return entity


def walls_entity(boxes: NDArray[np.float32], stamp_ns: int) -> SceneEntity:
    """The known walls, raised; boxes (N, 4) of middle x, y and sizes, metres."""
    entity, rgb = _entity("walls", ARENA, stamp_ns), color(WALL)
    for x_m, y_m, width_m, depth_m in boxes.tolist():
        size = Vector3(x=width_m, y=depth_m, z=WALL_HEIGHT_M)
        entity.cubes.append(CubePrimitive(pose=pose(x_m, y_m, WALL_HEIGHT_M / 2), size=size, color=rgb))
    return entity


def _entity(name: str, frame: str, stamp_ns: int) -> SceneEntity:
    return SceneEntity(timestamp=timestamp(stamp_ns), frame_id=frame, id=name)


def _label(text: str, z_m: float, x_m: float = 0.0, y_m: float = 0.0, *, size_m: float = LABEL_M) -> TextPrimitive:
    return TextPrimitive(
        pose=pose(x_m, y_m, z_m), billboard=True, font_size=size_m, scale_invariant=False, color=color(TEXT), text=text
    )


class BatteryPlot(msgspec.Struct, frozen=True, kw_only=True):
    """A battery as a few numbers to plot; JSON."""

    robot: str
    soc: float
    remaining_j: float
    voltage_v: float
    power_w: float


class VisualMessage(NamedTuple):
    """One derived message."""

    channel: str
    message: Message | BatteryPlot
    """Protobuf as Foxglove defines it, or a struct that goes as JSON."""
    stamp_ns: int

    @property
    def encoding(self) -> str:
        """Encoding of the message."""
        return "protobuf" if isinstance(self.message, Message) else "json"

    def data(self) -> bytes:
        """The message, encoded."""
        message = self.message
        return message.SerializeToString() if isinstance(message, Message) else msgspec.json.encode(message)

    def schema(self) -> tuple[str, str, bytes]:
        """Name, encoding and text of its schema."""
        if isinstance(self.message, Message):
            described = build_file_descriptor_set(type(self.message)).SerializeToString()
            return self.message.DESCRIPTOR.full_name, "protobuf", described
        schema = plain_schema(msgspec.json.schema(type(self.message)))
        return BATTERY_SCHEMA, "jsonschema", msgspec.json.encode(schema)


class FoxgloveChannels:
    """Derives the visual channels of one run. Messages that do not decode are left out."""

    def __init__(self) -> None:
        self._latest: dict[str, dict[str, bytes]] = {topic.name: {} for topic in LATEST}
        """The latest payloads that were not drawn yet, by topic and key."""
        self._decoded: dict[str, RobotState] = {}
        self._indices: dict[str, int] = {}
        self.known_map = KnownMap()
        """The map so far."""
        self._lines: list[tuple[Topic[Any], bytes]] = []
        self._open_tasks: dict[str, TaskEvent] = {}
        self._tasks_changed = False
        self._trails: dict[str, list[Point2D]] = {}
        self._map_view = self.known_map.merged()
        self._map_shown = self._walls_shown = 0
        self._due_ns: dict[str, int] = {}

    def handle(self, topic: Topic[Any], key: str, payload: bytes) -> None:
        """The next recorded message; topics that are not drawn are ignored."""
        latest = self._latest.get(topic.name)
        if latest is not None:
            latest[key] = payload
        elif topic is ROBOT_MAP:
            self.known_map.handle(payload)
        elif topic.name in LINE_NAMES and len(self._lines) < LINES_MAX:
            self._lines.append((topic, payload))

    def restart(self) -> None:
        """Publish all at the next `due`: a new file begins, which is to be drawn without the one before."""
        self._due_ns.clear()
        self._map_shown = self._walls_shown = 0
        self._tasks_changed = bool(self._open_tasks)

    def due(self, now_ns: int) -> Iterator[VisualMessage]:
        """The messages that are due at `now_ns` of the recorder's clock."""
        if self._lines:
            yield from self._received_lines(now_ns)
        if self._is_due("transforms", TRANSFORMS_NS, now_ns) and self._latest[ROBOT_STATE.name]:
            self._decode_states()
            poses = [
                (state.robot, state.pose, state.stamp_ns) for state in self._decoded.values() if state.pose is not None
            ]
            if poses:
                yield VisualMessage(visual_topics.TRANSFORMS, transforms(poses), now_ns)
        if self._is_due("scans", SCANS_NS, now_ns):
            with_points = self._is_due("points", 2 * SCANS_NS, now_ns)
            for scan in self._drain(ARENA_SCAN):
                channel = visual_topics.of_robot(scan.robot, "scan")
                yield VisualMessage(channel, laser_scan(scan, scan.stamp_ns), now_ns)
                if with_points:
                    channel = visual_topics.of_robot(scan.robot, "points")
                    yield VisualMessage(channel, scan_points(scan, scan.stamp_ns), now_ns)
        if self._is_due("robots", ROBOTS_NS, now_ns) and self._decoded:
            yield from self._robots(now_ns)
        if self._is_due("marks", MARKS_NS, now_ns):
            yield from self._marks(now_ns)
        if self._is_due("trails", TRAILS_NS, now_ns):
            for robot, trail in self._trails.items():
                channel = visual_topics.of_robot(robot, "trail")
                yield VisualMessage(channel, poses_in_frame(trail, now_ns), now_ns)
        if (self.known_map.has_news or self._map_shown != self._map_view.version) and self._is_due(
            "map", self._map_period_ns(), now_ns
        ):
            yield from self._map_messages(now_ns)
        yield from self._walls(now_ns)

    def _is_due(self, what: str, period_ns: int, now_ns: int) -> bool:
        due_ns = self._due_ns.get(what)
        # A clock that was set back by more than a period is followed at once.
        if due_ns is not None and due_ns - period_ns <= now_ns < due_ns:
            return False
        self._due_ns[what] = now_ns + period_ns
        return True

    def _decode_states(self) -> None:
        for state in self._drain(ROBOT_STATE):
            self._decoded[state.robot] = state
            self._indices.setdefault(state.robot, len(self._indices))
            if state.pose is not None:
                trail = self._trails.setdefault(state.robot, [])
                if not trail or state.pose.distance_m(trail[-1]) >= TRAIL_STEP_M:
                    trail.append(Point2D(state.pose.x_m, state.pose.y_m))
                    del trail[:-TRAIL_POINTS]

    def _robots(self, now_ns: int) -> Iterator[VisualMessage]:
        placed = [state for state in self._decoded.values() if state.pose is not None]
        entities = [robot_entity(state, self._indices[state.robot], now_ns) for state in placed]
        yield VisualMessage(visual_topics.ROBOTS, scene_update(entities, now_ns), now_ns)
        for state in self._decoded.values():
            if (at := state.pose) is not None:
                own_pose = pose(at.x_m, at.y_m, yaw_rad=at.yaw_rad)
                message = PoseInFrame(timestamp=timestamp(state.stamp_ns), frame_id=ARENA, pose=own_pose)
                yield VisualMessage(visual_topics.of_robot(state.robot, "pose"), message, now_ns)
            if state.battery is not None:
                yield VisualMessage(visual_topics.of_robot(state.robot, "battery"), _battery(state), now_ns)

    def _marks(self, now_ns: int) -> Iterator[VisualMessage]:
        for path in self._drain(ROBOT_PATH):
            channel = visual_topics.of_robot(path.robot, "path")
            yield VisualMessage(channel, poses_in_frame(path.points, path.stamp_ns, z_m=0.05), now_ns)
        received = self._latest[MOTE_READING.name]
        if received and self._is_due("motes", 2 * MARKS_NS, now_ns):
            readings = [
                reading for payload in received.values() if (reading := MOTE_READING.payloads.read_if_valid(payload))
            ]
            entities = [entity for reading in readings if (entity := mote_entity(reading, now_ns))]
            if readings:
                yield VisualMessage(visual_topics.MOTES, scene_update(entities, now_ns), now_ns)
        if self._tasks_changed:
            self._tasks_changed = False
            entities = [task_entity(event, now_ns) for event in self._open_tasks.values()]
            yield VisualMessage(visual_topics.TASKS, scene_update(entities, now_ns), now_ns)

    def _map_period_ns(self) -> int:
        grid = self._map_view.grid
        cells = 0 if grid is None else grid.geometry.width * grid.geometry.height
        return max(MAP_NS, to_ns(cells / CELLS_A_SECOND))

    def _map_messages(self, now_ns: int) -> Iterator[VisualMessage]:
        view = self._map_view = self.known_map.merged()
        if view.grid is None or view.version == self._map_shown:
            return
        self._map_shown = view.version
        yield VisualMessage(visual_topics.MAP, map_grid(view.grid, now_ns), now_ns)

    def _walls(self, now_ns: int) -> Iterator[VisualMessage]:
        view = self._map_view
        if view.grid is not None and self._walls_shown != view.version and self._is_due("walls", WALLS_NS, now_ns):
            self._walls_shown = view.version
            boxes = DrawnFloor(view.grid.geometry, view.grid.classes()).wall_boxes()
            yield VisualMessage(visual_topics.WALLS, scene_update([walls_entity(boxes, now_ns)], now_ns), now_ns)
            yield VisualMessage(visual_topics.WALL_POINTS, wall_points(view.grid, now_ns), now_ns)

    def _received_lines(self, now_ns: int) -> Iterator[VisualMessage]:
        lines, self._lines = self._lines, []
        for topic, payload in lines:
            message = topic.payloads.read_if_valid(payload)
            if isinstance(message, TaskEvent):
                line = self._handle_task(message)
            elif isinstance(message, LogRecord):
                source = f"{message.robot} {message.source}"
                line = log(message.stamp_ns or now_ns, message.level, source, message.text)
            elif isinstance(message, Halt):
                word = "emergency halt" if message.halted else "resume"
                reason = f": {message.reason}" if message.reason else ""
                line = log(message.stamp_ns or now_ns, "error", "team", f"{word} by {message.by}{reason}")
            else:
                continue
            yield VisualMessage(visual_topics.LOG, line, now_ns)

    def _handle_task(self, event: TaskEvent) -> Message:
        self._tasks_changed = True
        self._open_tasks.pop(event.task.id, None)
        if not event.state.ended:
            self._open_tasks[event.task.id] = event
        holder = f" at {event.robot}" if event.robot else ""
        reason = f": {event.why}" if event.why else ""
        level = "warning" if event.state in ("failed", "lost_contact") else "info"
        return log(event.stamp_ns, level, "task", f"{event.task.id} {event.state}{holder}{reason}")

    def _drain(self, topic: Topic[Kind]) -> Iterator[Kind]:
        """The latest messages of a topic, which are then forgotten."""
        payloads, self._latest[topic.name] = self._latest[topic.name], {}
        for payload in payloads.values():
            if (message := topic.payloads.read_if_valid(payload)) is not None:
                yield message


def _battery(state: RobotState) -> BatteryPlot:
    battery = state.battery
    assert battery is not None
    return BatteryPlot(
        robot=state.robot,
        soc=battery.soc,
        remaining_j=battery.remaining_j,
        voltage_v=battery.voltage_v,
        power_w=battery.voltage_v * battery.current_a,
    )
