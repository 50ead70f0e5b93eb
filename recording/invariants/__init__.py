"""Invariants of a run: what must hold in every run, judged from its messages."""
