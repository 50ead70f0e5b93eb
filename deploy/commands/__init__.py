"""Commands to a running team."""
