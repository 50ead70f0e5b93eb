"""Soaks: many fault scripts, judged, and the failing ones shrunk."""
