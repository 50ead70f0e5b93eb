"""The nearest obstacle in each direction."""
