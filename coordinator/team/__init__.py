"""The team: robots, what they can do, their map, their halts."""
