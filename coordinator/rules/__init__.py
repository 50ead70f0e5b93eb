"""Rules: tasks that the coordinator makes when something is sensed."""
