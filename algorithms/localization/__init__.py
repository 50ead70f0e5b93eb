"""Where a robot is."""
