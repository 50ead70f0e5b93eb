"""`robrain doctor`: what keeps a robot, or the parts of a machine, from joining a team."""
