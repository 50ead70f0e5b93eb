"""Planning in a separate process."""
