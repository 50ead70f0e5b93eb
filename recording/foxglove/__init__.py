"""Channels for Foxglove."""
