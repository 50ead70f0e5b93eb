"""The IMU of a ROS 2 robot."""
