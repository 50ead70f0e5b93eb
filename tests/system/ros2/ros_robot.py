"""A ROS 2 robot in a process of its own, the map that it drives on, and a ROS 2 node that listens to it."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
import rclpy.context
from geometry_msgs.msg import PoseStamped
from PIL import Image
from rclpy.executors import SingleThreadedExecutor

from tests.ros_domain import Domain

ROBOT_NODE = Path(__file__).parents[3] / "examples" / "ros2_robot" / "robot_node.py"
CELL_M = 0.05
WALL_CELLS = 2
ROOM_M = (6.0, 4.0)
GRID = {"resolution_m": CELL_M, "origin_x_m": -0.5, "origin_y_m": -0.5, "width_m": 7.0, "height_m": 5.0}
"""[parameters.mapper] of the room."""


def draw_room(folder: Path) -> Path:
    """A map of 6 × 4 m with a wall across the middle that leaves a doorway of 1.4 m; its corner is (0, 0)."""
    width, height = (round(side_m / CELL_M) + 2 * WALL_CELLS for side_m in ROOM_M)
    grey = np.full((height, width), 254, np.uint8)
    grey[:WALL_CELLS], grey[-WALL_CELLS:], grey[:, :WALL_CELLS], grey[:, -WALL_CELLS:] = 0, 0, 0, 0
    grey[: round(2.6 / CELL_M), width // 2 : width // 2 + WALL_CELLS] = 0
    Image.fromarray(grey).save(folder / "room.png")
    edge_m = -WALL_CELLS * CELL_M
    words = f"image: room.png\nresolution: {CELL_M}\norigin: [{edge_m}, {edge_m}, 0.0]\nnegate: 0\nfree_thresh: 0.196\n"
    (folder / "room.yaml").write_text(words)
    return folder / "room.yaml"


class RosRobot:
    """The node of examples/ros2_robot.

    Args:
        room: its map.
        domain: its ROS domain.
        namespace: of its topics.
        settings: further ROS parameters.

    """

    def __init__(self, room: Path, domain: Domain, *, namespace: str = "/r1", **settings: object) -> None:
        self._domain = domain
        parameters = {"map": room, "x": 1.0, "y": 1.0, "yaw": 0.0} | settings
        said = [word for name, value in parameters.items() for word in ("-p", f"{name}:={_text(value)}")]
        self._words = [sys.executable, str(ROBOT_NODE), "--ros-args", *said, "-r", f"__ns:={namespace}"]
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it; it is where it started first."""
        environment = {**os.environ, **self._domain.variables}
        self._process = subprocess.Popen(self._words, env=environment, stderr=subprocess.DEVNULL)

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal."""
        assert self._process is not None
        self._process.send_signal(number)

    def kill(self) -> None:
        """End it as if its computer had lost power."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()


class Listener:
    """A node of the test's own."""

    def __init__(self, domain: Domain) -> None:
        self._context = rclpy.context.Context()
        rclpy.init(args=["--ros-args", "--disable-external-lib-logs"], context=self._context, domain_id=domain.id)
        self.node: Any = rclpy.create_node("listener", context=self._context, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.truth: PoseStamped | None = None
        self.node.create_subscription(PoseStamped, "/r1/ground_truth", self._see, 1)

    def _see(self, message: PoseStamped) -> None:
        self.truth = message

    def spin(self, seconds: float, until: Callable[[], object] = lambda: False) -> bool:
        """Take what comes for so long, or until it is so; returns whether it is."""
        ends_s = time.monotonic() + seconds
        while not (is_so := bool(until())) and time.monotonic() < ends_s:
            self._executor.spin_once(timeout_sec=0.02)
        return is_so

    def place_m(self) -> tuple[float, float]:
        """Where the robot really is now, on its map."""
        self.truth = None
        assert self.spin(30.0, lambda: self.truth is not None), "the robot does not tell where it is"
        assert self.truth is not None
        return self.truth.pose.position.x, self.truth.pose.position.y

    def path_m(self, seconds: float) -> float:
        """How far the robot is after so long from where it was."""
        x_m, y_m = self.place_m()
        self.spin(seconds)
        later_x_m, later_y_m = self.place_m()
        return float(np.hypot(later_x_m - x_m, later_y_m - y_m))

    def close(self) -> None:
        """End the node."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()


ROLES = {"mocdevice": "ros2_base", "scan": "ros2_scan", "bm2": "ros2_battery"}
LOAD = ("explore", "visit", "battery", "energy", "wander", "command")


def robot_file(*, roles: Mapping[str, str] = ROLES, load: Sequence[str] = LOAD, **parameters: dict[str, object]) -> str:
    """ROBOT.toml of the robot: its devices are ROS 2's, what is above them is stock unless `roles` says otherwise."""
    import tomli_w

    known: dict[str, dict[str, object]] = {
        "mocdevice": {"namespace": "/r1", "speed_m_s": 0.8, "turn_rate_rad_s": 2.0},
        "scan": {"namespace": "/r1"},
        "bm2": {"namespace": "/r1"},
        "localisation": {"x_m": 1.0, "y_m": 1.0, "yaw_rad": 0.0},
        "mapper": dict(GRID),
    }
    for name, changed in parameters.items():
        known[name] = known.get(name, {}) | changed
    table = {"name": "r1", "load": list(load), "roles": dict(roles)}
    return tomli_w.dumps({"robot": table, "parameters": known})


def _text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
