"""`robrain task`."""
