"""Monitor: the robot watches a room."""
