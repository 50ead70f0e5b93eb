"""Common code of the plugins for ROS 2 robots: one node of the process, times, and the stop of a driving robot."""
