"""How accurate maps are, and how robots with unknown starts join."""
