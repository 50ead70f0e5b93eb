"""What travels between a robot, its plugins and the team."""
