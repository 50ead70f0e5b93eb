"""Faults of hardware, processes and the wire: their specification in a scenario, and their effect on a run."""
