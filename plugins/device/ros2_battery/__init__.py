"""The battery of a ROS 2 robot."""
