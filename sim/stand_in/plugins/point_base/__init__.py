"""Point base: moves the point."""
