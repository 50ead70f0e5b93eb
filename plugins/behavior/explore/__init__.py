"""Exploration of unknown floor."""
