"""Batteries: BM², the battery manager on the CAN bus, and those that can take its place."""
