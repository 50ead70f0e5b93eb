"""Idle: what the robot does with nothing to do."""
