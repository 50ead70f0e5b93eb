"""The processes of a live team."""
