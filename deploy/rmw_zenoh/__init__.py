"""`robrain ros2-zenoh`: a team as ROS 2 nodes on rmw_zenoh see it."""
