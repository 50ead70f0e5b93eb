"""Wander: the robot goes about at random."""
