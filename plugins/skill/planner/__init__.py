"""Paths through the map."""
