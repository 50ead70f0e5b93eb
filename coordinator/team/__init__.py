"""The team: robots, their abilities, their map, their halts."""
