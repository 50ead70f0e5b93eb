"""Shows a team to ROS 2 by rclpy, and takes orders from there."""

import math
from array import array
from collections.abc import Iterable
from typing import Any

import msgspec
import numpy as np
from geometry_msgs.msg import PoseStamped, TransformStamped
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String
from std_srvs.srv import Trigger

from robrain.deploy.ros2.team_publisher import Answer, Orders, ShownMap, ros_name
from robrain.plugins.device.ros2.link import Publisher, Ros2Link
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.wire.clock import NS_PER_S
from robrain.protocol.wire.messages.team.arena_messages import Scan

try:
    from tf2_msgs.msg import TFMessage
except ModuleNotFoundError:  # it comes with an installed ROS 2, not from the package index
    TFMessage = None
try:
    from robrain_msgs.srv import SubmitTask
except ModuleNotFoundError:  # built from examples/robrain_msgs
    SubmitTask = None

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)
"""For maps, as map_server has it: late subscribers get the last one."""
EVENTS = QoSProfile(depth=100)
ROBOTS_MAX = 1000
"""Robots of further names are not shown: each has topics of its own."""
ANSWER_TOPIC, SUBMIT_TOPIC = "/robrain/task_answers", "/robrain/submit_task"
BASE_FRAME = "base_link"


class RclpyPublisher:
    """The topics of a team, under `/robrain`.

    Args:
        link: the node.
        frame: name of the team's frame in ROS.

    """

    def __init__(self, link: Ros2Link, frame: str) -> None:
        self._link, self._frame = link, frame
        self._map = link.publisher(OccupancyGrid, "/robrain/map", LATCHED)
        self._events = link.publisher(String, "/robrain/task_events", EVENTS)
        self._transforms = link.publisher(TFMessage, "/tf", QoSProfile(depth=100)) if TFMessage is not None else None
        self._of_robots: dict[tuple[str, str], Publisher] = {}
        self._shown: set[str] = set()

    def show_map(self, shown: ShownMap) -> None:
        """The team's map, for late subscribers as well."""
        grid = OccupancyGrid()
        self._head(grid, shown.stamp_ns)
        grid.info.map_load_time = grid.header.stamp
        grid.info.height, grid.info.width = shown.cells.shape
        grid.info.resolution = shown.resolution_m
        grid.info.origin.position.x, grid.info.origin.position.y = shown.origin_x_m, shown.origin_y_m
        grid.data = array("b", np.ascontiguousarray(shown.cells, dtype=np.int8).tobytes())
        self._map.publish(grid)

    def show_pose(self, robot: str, pose: Pose2D, stamp_ns: int) -> None:
        """Where a robot is: as a topic, and as the transform of its `base_link`."""
        publisher = self._of(robot, "pose", PoseStamped, EVENTS)
        if publisher is None:
            return
        placed = PoseStamped()
        self._head(placed, stamp_ns)
        _put(placed.pose, pose)
        publisher.publish(placed)
        if self._transforms is not None:
            transform = TransformStamped(header=placed.header, child_frame_id=f"{ros_name(robot)}/{BASE_FRAME}")
            transform.transform.translation.x, transform.transform.translation.y = pose.x_m, pose.y_m
            transform.transform.rotation = placed.pose.orientation
            self._transforms.publish(TFMessage(transforms=[transform]))

    def show_path(self, robot: str, points: list[Point2D], stamp_ns: int) -> None:
        """Where it means to go, for late subscribers as well; each pose faces the next one."""
        publisher = self._of(robot, "path", Path, LATCHED)
        if publisher is None:
            return
        path = Path()
        self._head(path, stamp_ns)
        path.poses = [PoseStamped(header=path.header) for _ in points]
        for placed, pose in zip(path.poses, _facing_on(points), strict=True):
            _put(placed.pose, pose)
        publisher.publish(path)

    def show_scan(self, scan: Scan) -> None:
        """A turn of its lidar, in the frame of its `base_link`."""
        publisher = self._of(scan.robot, "scan", LaserScan, qos_profile_sensor_data)
        if publisher is None:
            return
        ranges_m = np.array(scan.ranges_mm, np.float32) / 1000.0
        ranges_m[ranges_m == 0.0] = np.inf  # REP 117
        turn = LaserScan()
        self._head(turn, scan.stamp_ns)
        turn.header.frame_id = f"{ros_name(scan.robot)}/{BASE_FRAME}"
        turn.angle_min, turn.angle_increment = scan.angle_min_rad, scan.angle_increment_rad
        turn.angle_max = scan.angle_min_rad + scan.angle_increment_rad * max(len(ranges_m) - 1, 0)
        turn.range_max = scan.range_max_m
        turn.ranges = array("f", ranges_m.tobytes())
        publisher.publish(turn)

    def tell_event(self, text: str) -> None:
        """A change of a task, as JSON."""
        self._events.publish(String(data=text))

    def _of(self, robot: str, what: str, kind: type[Any], qos: QoSProfile) -> Publisher | None:
        name = ros_name(robot)
        publisher = self._of_robots.get((name, what))
        if publisher is None and (name in self._shown or len(self._shown) < ROBOTS_MAX):
            self._shown.add(name)
            publisher = self._link.publisher(kind, f"/robrain/{name}/{what}", qos)
            self._of_robots[name, what] = publisher
        return publisher

    def _head(self, message: Any, stamp_ns: int) -> None:
        message.header.frame_id = self._frame
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(max(stamp_ns, 0), NS_PER_S)


def take_orders(tasks: Ros2Link, halts: Ros2Link, orders: Orders) -> None:
    """Offer services and a topic for orders until the nodes are closed.

    Args:
        tasks: its thread waits for the coordinator's answers.
        halts: its thread waits for nothing else than halts.
        orders: what is done.

    """
    answers = tasks.publisher(String, ANSWER_TOPIC, EVENTS)

    def submit(request: Any, response: Any) -> Any:
        response.accepted, response.answer = orders.submit(request.task)
        return response

    def submit_text(message: Any) -> None:
        answers.publish(String(data=_answer_text(orders.submit(message.data))))

    def halt(_request: Any, response: Any) -> Any:
        response.success, response.message = orders.halt()
        return response

    tasks.do(lambda: tasks.node.create_subscription(String, SUBMIT_TOPIC, submit_text, EVENTS))
    if SubmitTask is not None:
        tasks.do(lambda: tasks.node.create_service(SubmitTask, SUBMIT_TOPIC, submit))
    halts.do(lambda: halts.node.create_service(Trigger, "/robrain/halt", halt))


def _answer_text(answer: Answer) -> str:
    return msgspec.json.encode(answer._asdict()).decode()


def _facing_on(points: list[Point2D]) -> Iterable[Pose2D]:
    yaw_rad = 0.0
    for index, point in enumerate(points):
        if index + 1 < len(points):
            after = points[index + 1]
            yaw_rad = math.atan2(after.y_m - point.y_m, after.x_m - point.x_m)
        yield Pose2D(point.x_m, point.y_m, yaw_rad)


def _put(placed: Any, pose: Pose2D) -> None:
    placed.position.x, placed.position.y = pose.x_m, pose.y_m
    placed.orientation.z, placed.orientation.w = math.sin(pose.yaw_rad / 2), math.cos(pose.yaw_rad / 2)
