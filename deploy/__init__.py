"""What it takes to run a team elsewhere."""
