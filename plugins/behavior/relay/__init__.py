"""Relay: the robot is the link to a mote."""
