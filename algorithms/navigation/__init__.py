"""Where a robot may drive, and how it gets there."""
