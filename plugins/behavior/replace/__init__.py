"""Replace: the robot stands in for a mote."""
