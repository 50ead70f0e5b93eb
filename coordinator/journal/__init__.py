"""The journal: every change of a task is on disk before anybody is told of it."""
