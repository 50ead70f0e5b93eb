"""Leaves modules out of the doctests: one that loads too much, and without ROS 2 those that need it."""

from importlib.util import find_spec

WITH_RCLPY = (
    *("robrain/plugins/device/ros2*/*", "robrain/plugins/unit/ros2_navigator/*", "robrain/deploy/ros2/rclpy_port.py"),
    *("plugins/device/ros2*/*", "plugins/unit/ros2_navigator/*", "deploy/ros2/rclpy_port.py"),
    "tests/system/ros2/ros_robot.py",
)
LOADS_KERNELS = ("robrain/deploy/sweep/forked_from.py", "deploy/sweep/forked_from.py")
"""It loads all kernels when it is imported."""
collect_ignore_glob = [*LOADS_KERNELS, *(WITH_RCLPY if find_spec("rclpy") is None else ())]
