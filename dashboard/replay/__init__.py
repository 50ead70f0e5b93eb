"""A recording in place of a team."""
