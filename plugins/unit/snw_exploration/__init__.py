"""The sensor network: readings of the motes in reach."""
