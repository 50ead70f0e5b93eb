"""The dashboard's state of the team; no browser."""
