"""The base of a ROS 2 robot."""
