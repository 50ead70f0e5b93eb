"""Doors, moving obstacles and people of a simulated floor."""
