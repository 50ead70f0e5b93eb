"""Point visit: goes to a place and stays there."""
