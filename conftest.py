"""Leaves the modules that import rclpy out of the doctests where ROS 2 is not installed; their tests say so."""

from importlib.util import find_spec

WITH_RCLPY = (
    *("robrain/plugins/device/ros2*/*", "robrain/plugins/unit/ros2_navigator/*", "robrain/deploy/ros2/rclpy_port.py"),
    *("plugins/device/ros2*/*", "plugins/unit/ros2_navigator/*", "deploy/ros2/rclpy_port.py"),
    "tests/system/ros2/ros_robot.py",
)
collect_ignore_glob = list(WITH_RCLPY) if find_spec("rclpy") is None else []
