"""The entities of Foxglove's scene: robots, motes, tasks and walls.

Each message holds all of its channel, so that a viewer that jumps into a recording needs the last one alone.
"""

from collections.abc import Iterable, Mapping

from foxglove_schemas_protobuf.ArrowPrimitive_pb2 import ArrowPrimitive
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from numpy import float32
from numpy.typing import NDArray

from robrain.protocol.wire.messages.motes.mote_messages import MoteReading
from robrain.protocol.wire.messages.robots.robot_messages import RobotState
from robrain.protocol.wire.messages.tasks.offer_messages import TaskEvent
from robrain.recording.drawing.palette import FRONTIER, HALTED, LOST, NOSE, WALL, WARNING, Rgb, look_of, mote_color
from robrain.recording.foxglove.messages import ARENA, color, point, pose, timestamp, wall_cubes

ROBOT_HEIGHT_M = 0.25
LABEL_M = 0.35
TEXT: Rgb = (235, 238, 242)


def scene(entities: Iterable[SceneEntity], stamp_ns: int) -> SceneUpdate:
    """A message that takes the place of all before it on its channel."""
    return SceneUpdate(
        deletions=[SceneEntityDeletion(timestamp=timestamp(stamp_ns), type=SceneEntityDeletion.ALL)], entities=entities
    )


def robot_entity(state: RobotState, index: int, stamp_ns: int) -> SceneEntity:
    """A robot in its own frame: footprint, nose and name; `index` chooses its colour."""
    radius_m = state.radius_m or 0.2
    body = HALTED if state.halted else LOST if state.lost else look_of(index).color
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


def walls_entity(boxes: NDArray[float32], stamp_ns: int) -> SceneEntity:
    """The known walls, raised."""
    entity = _entity("walls", ARENA, stamp_ns)
    entity.cubes.extend(wall_cubes(boxes, WALL))
    return entity


def robots_scene(states: Mapping[str, RobotState], indices: Mapping[str, int], stamp_ns: int) -> SceneUpdate:
    """All robots that know where they are."""
    entities = (
        robot_entity(state, indices[robot], stamp_ns) for robot, state in states.items() if state.pose is not None
    )
    return scene(entities, stamp_ns)


def _entity(name: str, frame: str, stamp_ns: int) -> SceneEntity:
    return SceneEntity(timestamp=timestamp(stamp_ns), frame_id=frame, id=name)


def _label(text: str, z_m: float, x_m: float = 0.0, y_m: float = 0.0, *, size_m: float = LABEL_M) -> TextPrimitive:
    return TextPrimitive(
        pose=pose(x_m, y_m, z_m), billboard=True, font_size=size_m, scale_invariant=False, color=color(TEXT), text=text
    )
