"""Controlled motion."""
