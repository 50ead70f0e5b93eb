"""Submaps, scan matching against them, loop closures and the graph of poses."""
