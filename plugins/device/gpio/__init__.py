"""Contacts on GPIO lines: bumpers and the emergency stop's button."""
