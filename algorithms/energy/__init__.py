"""Batteries, and what work costs."""
