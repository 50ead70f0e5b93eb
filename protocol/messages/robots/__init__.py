"""Messages between a robot, its plugins and the team."""
