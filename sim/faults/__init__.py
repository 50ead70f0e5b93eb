"""Faults of hardware, processes and the wire: what a scenario says of them, and what they do to a run."""
