"""The lidar of a ROS 2 robot."""
