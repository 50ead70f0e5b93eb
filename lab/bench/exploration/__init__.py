"""Exploration strategies and team sizes, compared."""
