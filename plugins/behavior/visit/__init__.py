"""Visit: the robot goes to a place."""
