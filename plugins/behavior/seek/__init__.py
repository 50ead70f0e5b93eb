"""Seek: the robot finds the source of what is sensed."""
