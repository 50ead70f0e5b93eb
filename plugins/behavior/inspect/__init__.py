"""Inspect: the robot goes to a place and takes a picture."""
