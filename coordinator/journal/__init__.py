"""The journal: every change of a task is on disk before it is published."""
