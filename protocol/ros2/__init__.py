"""ROS 2 nodes on `rmw_zenoh`, spoken to over Zenoh itself, without ROS (docs/explanation/ros2.md)."""
