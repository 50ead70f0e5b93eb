"""Invariants of a run: rules that hold in every run, judged from its messages."""
