"""Meaning of the messages: pure functions on poses, grids and paths, without I/O."""
