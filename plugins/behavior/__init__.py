"""Behaviors: the robot's visible activities."""
