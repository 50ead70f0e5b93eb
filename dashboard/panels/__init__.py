"""The tabs and controls of a page."""
