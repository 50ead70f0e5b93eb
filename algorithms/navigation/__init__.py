"""Drivable floor, paths, and right of way."""
