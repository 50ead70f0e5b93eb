"""Metrics of a team for Prometheus, and structured logs."""
