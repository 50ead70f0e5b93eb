"""Motes as members of the team."""
