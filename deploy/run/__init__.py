"""Lockstep runs."""
