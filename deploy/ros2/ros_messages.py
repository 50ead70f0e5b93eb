"""Messages of ROS 2 made from the team's: pure functions. Metres and radians, x forward, y left (REP 103)."""

import math
from typing import Any, TypeVar

import msgspec
import numpy as np

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid as Grid
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.ros2 import message_classes as classes
from robrain.protocol.ros2 import message_types as ros
from robrain.protocol.ros2.message_types import MessageType
from robrain.protocol.wire.messages.robots.robot_messages import BatteryState, PlannedPath, RobotState
from robrain.protocol.wire.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.wire.messages.team.arena_messages import Scan
from robrain.recording.drawing.palette import FRONTIER, HALTED, LOST, WARNING, Rgb, look_of

SECOND_NS = 1_000_000_000
STAMP_MAX_S = 2**31 - 1
"""Of ROS 2's time."""
ROBOT_HEIGHT_M = 0.25
LABEL_M = 0.25
CYLINDER, SPHERE, TEXT, DELETE_ALL = 3, 2, 9, 3
"""Of `visualization_msgs/msg/Marker`: types, and the action that removes what was drawn."""
CHARGING, DISCHARGING, GOOD = 1, 2, 1
"""Of `sensor_msgs/msg/BatteryState`."""
MARKERS_MAX = 4096

M = TypeVar("M")


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


def occupancy_grid(grid: Grid, frame: str, stamp_ns: int) -> classes.OccupancyGrid:
    """The map: −1 unknown, 0 free, 100 occupied, rows from the lowest y, as ROS 2 has them too."""
    geometry = grid.geometry
    message = stamped(ros.OCCUPANCY_GRID, frame, stamp_ns, data=grid.classes().ravel())
    message.info.resolution = geometry.resolution_m
    message.info.width, message.info.height = geometry.width, geometry.height
    _set_time(message.info.map_load_time, stamp_ns)
    _place(message.info.origin, Pose2D(geometry.origin_x_m, geometry.origin_y_m, 0.0))
    return message


def pose_stamped(pose: Pose2D, frame: str, stamp_ns: int) -> classes.PoseStamped:
    """Where a robot is."""
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


def path(planned: PlannedPath, frame: str) -> classes.Path:
    """A robot's path; each pose looks to the next point."""
    message = stamped(ros.PATH, frame, planned.stamp_ns)
    yaw_rad = 0.0
    for point, after in zip(planned.points, [*planned.points[1:], None], strict=False):
        if after is not None:
            yaw_rad = math.atan2(after.y_m - point.y_m, after.x_m - point.x_m)
        pose = stamped(ros.POSE_STAMPED, frame, planned.stamp_ns)
        _place(pose.pose, Pose2D(point.x_m, point.y_m, yaw_rad))
        message.poses.append(pose)
    return message


def laser_scan(scan: Scan) -> classes.LaserScan:
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


def battery(robot: str, state: BatteryState, stamp_ns: int) -> classes.BatteryState:
    """A battery; its current is negative while it discharges, and what is not measured is NaN."""
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


def task_event(event: TaskEvent) -> classes.String:
    """A change of a task as the JSON that robrain itself sends."""
    return classes.String(msgspec.json.encode(event).decode())


def markers(
    states: dict[str, RobotState], tasks: dict[str, TaskEvent], frame: str, stamp_ns: int
) -> classes.MarkerArray:
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
        body = HALTED if state.halted else LOST if state.lost else look_of(index).color
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
    return classes.MarkerArray(drawn[:MARKERS_MAX])


def _marker(
    group: str,
    number: int,
    frame: str,
    shape: int,
    size_m: tuple[float, float, float],
    rgb: Rgb,
    at_m: tuple[float, float, float],
    text: str = "",
) -> classes.Marker:
    """A marker that stays where its frame is, at whatever time."""
    marker = stamped(ros.MARKER, frame, 0, ns=group, id=number, type=shape, text=text, frame_locked=True)
    marker.scale.x, marker.scale.y, marker.scale.z = size_m
    marker.pose.position.x, marker.pose.position.y, marker.pose.position.z = at_m
    marker.pose.orientation.w = 1.0
    marker.color.r, marker.color.g, marker.color.b = (part / 255 for part in rgb)
    marker.color.a = 1.0
    return marker


def _place(message: classes.Pose, pose: Pose2D) -> None:
    message.position.x, message.position.y = pose.x_m, pose.y_m
    message.orientation.z, message.orientation.w = math.sin(pose.yaw_rad / 2), math.cos(pose.yaw_rad / 2)


def _set_time(stamp: Any, stamp_ns: int) -> None:
    stamp.sec, stamp.nanosec = min(max(stamp_ns, 0) // SECOND_NS, STAMP_MAX_S), max(stamp_ns, 0) % SECOND_NS
