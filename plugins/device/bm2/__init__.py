"""Batteries: BM², the battery manager on the CAN bus, and its alternatives."""
