"""What the plugins for ROS 2 robots share: one node of the process, times, and the stop of a robot that drives."""
