"""What a message for Foxglove says: of scans, points, grids, walls, logs, and of the entities of its scene."""

import math
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.protocol.messages.motes.mote_messages import MoteReading
from robrain.protocol.messages.robots.robot_messages import BatteryState, PluginFault, RobotState, TaskStatus
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.team.arena_messages import Scan
from robrain.protocol.model import grid_geometry as cells
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.recording.drawing.palette import (
    BAD,
    FREE,
    FRONTIER,
    GOOD,
    HALTED,
    LOST,
    NOSE,
    OCCUPIED,
    UNKNOWN,
    WARNING,
    style_of,
)
from robrain.recording.foxglove import channels as foxglove_scene
from robrain.recording.foxglove import channels as make


def scan(*ranges_mm: int, **fields: Any) -> Scan:
    told = {"robot": "r1", "angle_min_rad": 0.0, "angle_increment_rad": math.pi / 2, "range_max_m": 5.0, **fields}
    return Scan(ranges_mm=list(ranges_mm), **told)


def floats(cloud: Any) -> Any:
    assert (cloud.point_stride, [(field.name, field.offset, field.type) for field in cloud.fields]) == (
        12, [("x", 0, 7), ("y", 4, 7), ("z", 8, 7)],
    )  # fmt: skip
    return np.frombuffer(cloud.data, np.float32).reshape(-1, 3)


def xyz(of: Any) -> tuple[float, float, float]:
    return round(of.x, 9), round(of.y, 9), round(of.z, 9)


def rgba(color: Any) -> tuple[int, int, int, float]:
    return round(255 * color.r), round(255 * color.g), round(255 * color.b), color.a


def floor() -> OccupancyGrid:
    """Half metres from (10, 20): a free, an occupied and an unknown column, two rows."""
    grid = OccupancyGrid(GridGeometry(0.5, 10.0, 20.0, 3, 2))
    grid.merge_patch(0, 0, np.array([[cells.FREE, cells.OCCUPIED, cells.UNKNOWN]] * 2), 1)
    return grid


@pytest.mark.parametrize(
    ("stamp_ns", "told_ns"),
    [(-1, 0), (0, 0), (1_500_000_001, 1_500_000_001), (2**63 - 1, 2**63 - 1), (2**80, 2**63 - 1)],
)
def test_a_stamp_is_the_nearest_that_can_be_told(stamp_ns: int, told_ns: int) -> None:
    assert make.timestamp(stamp_ns).ToNanoseconds() == told_ns


@pytest.mark.parametrize("yaw_rad", [-math.pi / 2, 0.0, 0.3, math.pi / 2, 3.0])
def test_a_turn_about_z_is_a_unit_quaternion_of_half_the_angle(yaw_rad: float) -> None:
    turn = make.yaw_quaternion(yaw_rad)
    assert (turn.x, turn.y) == (0.0, 0.0)
    assert turn.z**2 + turn.w**2 == pytest.approx(1.0)
    assert 2 * math.atan2(turn.z, turn.w) == pytest.approx(yaw_rad)


def test_a_pose_is_in_the_arenas_frame_and_has_its_stamp() -> None:
    found = make.pose_in_frame(Pose2D(1.0, 2.0, math.pi), 7)
    assert (found.frame_id, found.timestamp.nanos) == ("arena", 7)
    assert xyz(found.pose.position) == (1.0, 2.0, 0.0)
    assert (found.pose.orientation.z, found.pose.orientation.w) == (pytest.approx(1.0), pytest.approx(0.0))


def test_a_robots_frame_is_where_the_robot_is() -> None:
    [found] = make.transforms([("r1", Pose2D(1.0, 2.0, math.pi / 2), 7)]).transforms
    assert (found.parent_frame_id, found.child_frame_id, found.timestamp.nanos) == ("arena", "r1", 7)
    assert xyz(found.translation) == (1.0, 2.0, 0.0)
    assert (found.rotation.z, found.rotation.w) == (pytest.approx(math.sqrt(0.5)), pytest.approx(math.sqrt(0.5)))


def test_a_scan_spans_the_angles_of_its_beams() -> None:
    found = make.laser_scan(scan(1000, 0, 2500, angle_min_rad=-1.0, angle_increment_rad=0.5), 7)
    assert (found.start_angle, found.end_angle) == (-1.0, 0.0)
    assert list(found.ranges) == [1.0, math.inf, 2.5]
    assert (found.frame_id, found.timestamp.nanos) == ("r1", 7)
    assert xyz(found.pose.position) == (0.0, 0.0, 0.1)


@pytest.mark.parametrize("ranges_mm", [(), (1000,)])
def test_a_scan_of_one_beam_or_none_ends_where_it_starts(ranges_mm: tuple[int, ...]) -> None:
    found = make.laser_scan(scan(*ranges_mm, angle_min_rad=-1.0), 0)
    assert (found.start_angle, found.end_angle) == (-1.0, -1.0)


def test_the_hits_of_a_scan_are_points_in_the_robots_frame() -> None:
    found = make.scan_points(scan(1, 0, 2000, 3000), 7)
    assert (found.frame_id, found.timestamp.nanos) == ("r1", 7)
    expected = [[0.001, 0.0, 0.1], [-2.0, 0.0, 0.1], [0.0, -3.0, 0.1]]
    assert floats(found) == pytest.approx(np.array(expected), abs=1e-6)
    assert xyz(found.pose.position) == (0.0, 0.0, 0.0)
    assert found.pose.orientation.w == 1.0


def test_the_middles_of_occupied_cells_are_points() -> None:
    found = make.wall_points(floor(), 7)
    assert (found.frame_id, found.timestamp.nanos) == ("arena", 7)
    assert floats(found).tolist() == [[10.75, 20.25, 0.0], [10.75, 20.75, 0.0]]
    assert xyz(found.pose.position) == (0.0, 0.0, 0.0)


def test_the_map_is_a_grid_of_colours_of_which_the_unknown_is_clear() -> None:
    found = make.map_grid(floor(), 7)
    assert (found.frame_id, found.timestamp.nanos) == ("arena", 7)
    assert xyz(found.pose.position) == (10.0, 20.0, -0.01)
    assert (found.column_count, found.row_stride, found.cell_stride) == (3, 12, 4)
    assert (found.cell_size.x, found.cell_size.y) == (0.5, 0.5)
    assert [(field.name, field.offset, field.type) for field in found.fields] == [
        ("red", 0, 1), ("green", 1, 1), ("blue", 2, 1), ("alpha", 3, 1),
    ]  # fmt: skip
    drawn = np.frombuffer(found.data, np.uint8).reshape(2, 3, 4)
    assert drawn[:, 0].tolist() == [[*FREE, 255]] * 2
    assert drawn[:, 1].tolist() == [[*OCCUPIED, 255]] * 2
    assert drawn[:, 2].tolist() == [[*UNKNOWN, 0]] * 2


@pytest.mark.parametrize(
    ("level", "told"),
    [("debug", Log.DEBUG), ("INFO", Log.INFO), ("warning", Log.WARNING), ("Error", Log.ERROR), ("critical", Log.FATAL),
     ("loud", Log.INFO)],
)  # fmt: skip
def test_a_line_of_a_log_has_its_level(level: str, told: int) -> None:
    found = make.log(7, level, "r1 scan", "no lidar")
    assert (found.level, found.name, found.message, found.timestamp.nanos) == (told, "r1 scan", "no lidar", 7)


# -- entities of the scene --------------------------------------------------------------------------------------


def test_a_scene_takes_the_place_of_all_before_it() -> None:
    found = foxglove_scene.scene_update([foxglove_scene.walls_entity(np.zeros((0, 4), np.float32), 3)], 7)
    assert [(one.type, one.timestamp.nanos) for one in found.deletions] == [(1, 7)]
    assert [entity.id for entity in found.entities] == ["walls"]


def test_a_robot_is_drawn_in_its_frame_with_footprint_nose_and_name() -> None:
    battery = BatteryState(voltage_v=24.0, current_a=1.0, temperature_c=30.0, soc=0.256, remaining_j=1e5)
    entity = foxglove_scene.robot_entity(RobotState(robot="r1", radius_m=0.5, battery=battery, behavior="idle"), 1, 7)
    assert (entity.id, entity.frame_id, entity.frame_locked, entity.timestamp.nanos) == ("robot r1", "r1", True, 7)
    [body] = entity.cylinders
    height_m = foxglove_scene.ROBOT_HEIGHT_M
    assert (xyz(body.size), xyz(body.pose.position)) == ((1.0, 1.0, height_m), (0.0, 0.0, height_m / 2))
    assert (body.bottom_scale, body.top_scale) == (1.0, 0.9)
    assert rgba(body.color) == (*style_of(1).color, 1.0)
    [nose] = entity.arrows
    assert (nose.shaft_length, nose.head_length, nose.head_diameter) == (0.3, 0.3, 0.3)
    assert nose.shaft_diameter == 0.125
    assert xyz(nose.pose.position) == (0.0, 0.0, pytest.approx(height_m + 0.02))
    assert rgba(nose.color) == (*NOSE, 1.0)
    [name] = entity.texts
    assert name.text == "r1 26 %"
    assert xyz(name.pose.position) == (0.0, 0.0, pytest.approx(height_m + 0.35))
    assert (name.billboard, name.scale_invariant, name.font_size) == (True, False, foxglove_scene.LABEL_M)
    assert rgba(name.color) == (*foxglove_scene.TEXT, 1.0)
    assert {pair.key: pair.value for pair in entity.metadata} == {"behavior": "idle"}


@pytest.mark.parametrize(
    ("halted", "lost", "color", "text"),
    [(True, "", HALTED, "r1 HALTED"), (True, "x", HALTED, "r1 HALTED"), (False, "x", LOST, "r1 lost"),
     (False, "", style_of(0).color, "r1")],
)  # fmt: skip
def test_a_robot_that_is_halted_or_lost_looks_so(halted: bool, lost: str, color: Any, text: str) -> None:
    entity = foxglove_scene.robot_entity(RobotState(robot="r1", halted=halted, lost=lost), 0, 0)
    assert rgba(entity.cylinders[0].color) == (*color, 1.0)
    assert entity.texts[0].text == text


def test_what_a_robot_is_at_and_what_is_wrong_with_it_is_told_beside_it() -> None:
    state = RobotState(
        robot="r1",
        task=TaskStatus(id="t1", epoch=1, state=TaskState.RUNNING),
        halted_by=["ann", "bob"],
        lost="kidnapped",
        faulted=[PluginFault(plugin="scan", why="no lidar"), PluginFault(plugin="map", why="")],
    )
    entity = foxglove_scene.robot_entity(state, 0, 0)
    assert {pair.key: pair.value for pair in entity.metadata} == {
        "task": "t1", "halted by": "ann, bob", "lost": "kidnapped", "faulted": "scan, map",
    }  # fmt: skip


def test_robots_that_know_where_they_are_are_drawn() -> None:
    states = {"r1": RobotState(robot="r1"), "r2": RobotState(robot="r2", pose=Pose2D(0.0, 0.0, 0.0))}
    found = foxglove_scene.robots_scene(states, {"r1": 0, "r2": 1}, 7)
    assert [(entity.id, rgba(entity.cylinders[0].color)) for entity in found.entities] == [
        ("robot r2", (*style_of(1).color, 1.0)),
    ]


@pytest.mark.parametrize(("voltage_v", "color"), [(2.7, GOOD), (2.69, WARNING), (2.4, WARNING), (2.39, BAD)])
def test_a_mote_is_drawn_at_its_place_in_the_colour_of_its_supply(voltage_v: float, color: Any) -> None:
    reading = MoteReading(mote="m1", place=Point2D(1.0, 2.0), quantity="°C", value=21.26, voltage_v=voltage_v,
                          rssi_dbm=-60.0, via="r1")  # fmt: skip
    entity = foxglove_scene.mote_entity(reading, 7)
    assert entity is not None
    assert (entity.id, entity.frame_id, entity.timestamp.nanos) == ("mote m1", "arena", 7)
    [ball] = entity.spheres
    assert (xyz(ball.pose.position), xyz(ball.size)) == ((1.0, 2.0, 0.12), (0.24, 0.24, 0.24))
    assert rgba(ball.color) == (*color, 1.0)
    [text] = entity.texts
    assert (text.text, xyz(text.pose.position), text.font_size) == ("m1 21.3 °C", (1.0, 2.0, 0.45), 0.2)


@pytest.mark.parametrize(("robot", "color", "text"), [("", WARNING, "t1 queued"), ("r1", FRONTIER, "t1 queued r1")])
def test_a_task_is_a_flag_at_its_place(robot: str, color: Any, text: str) -> None:
    event = TaskEvent(task=Task(id="t1", kind="visit", place=Point2D(1.0, 2.0)), state=TaskState.QUEUED, robot=robot)
    entity = foxglove_scene.task_entity(event, 7)
    assert (entity.id, entity.frame_id, entity.timestamp.nanos) == ("task t1", "arena", 7)
    [mast] = entity.lines
    assert (mast.type, mast.thickness, mast.scale_invariant) == (0, 3.0, True)
    assert [xyz(point) for point in mast.points] == [(1.0, 2.0, 0.0), (1.0, 2.0, 0.6)]
    assert (xyz(mast.pose.position), mast.pose.orientation.w) == ((0.0, 0.0, 0.0), 1.0)
    assert rgba(mast.color) == (*color, 1.0)
    [label] = entity.texts
    assert (label.text, label.font_size) == (f"visit {text}", 0.22)
    assert xyz(label.pose.position) == (1.0, 2.0, 0.75)
