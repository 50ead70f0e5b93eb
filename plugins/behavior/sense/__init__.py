"""Sense: the robot brings one reading from a place."""
