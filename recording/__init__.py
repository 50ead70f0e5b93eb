"""Recording: runs written to MCAP files with all it takes to make them again, read and replayed."""
