"""Mapping as a team: submaps, the map composed of them, loop closures and the pose graph."""
