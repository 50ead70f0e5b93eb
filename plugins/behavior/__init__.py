"""Behaviors: what the robot is seen to do."""
