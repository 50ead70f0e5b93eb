"""Batteries, and the cost of work."""
