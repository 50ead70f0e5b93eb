"""`robrain ros2`: a team as ROS 2 sees it."""
