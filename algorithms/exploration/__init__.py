"""Exploration: where the borders of the known are, and which robot goes to which."""
