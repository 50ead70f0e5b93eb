"""`robrain sweep`: one scenario with many seeds and settings, as a table, a summary and figures."""
