"""Recordings for other tools."""
