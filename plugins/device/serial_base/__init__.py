"""Bases whose motor controller is on a serial line."""
