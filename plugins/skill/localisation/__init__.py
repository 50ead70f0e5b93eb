"""Where the robot is."""
