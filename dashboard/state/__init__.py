"""The state of the team as the dashboard knows it; no browser."""
