"""The text form at a terminal of the robot."""
