"""Localisation of a robot."""
