"""Exploration: the borders of the known floor, and which robot goes to which."""
