"""Months of a mote field's life in seconds: energies and readings between the events that change routes."""
