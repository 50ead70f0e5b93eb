"""What the dashboard knows of the team; no browser."""
