"""Collect: the robot fetches what a mote has stored."""
