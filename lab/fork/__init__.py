"""Forks: a recorded lockstep run is repeated up to a moment, and changed from there."""
