"""Recording: runs written to MCAP files with all data that repeat them, read and replayed."""
