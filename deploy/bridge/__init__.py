"""Joins two teams on purpose, by rules."""
