"""Plugins of the stand-in: a base that moves a point, and behaviors that need nothing else."""
