"""Home: where the robot goes when it has to."""
