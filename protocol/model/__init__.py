"""What the messages mean: pure functions on poses, grids and paths, without I/O."""
