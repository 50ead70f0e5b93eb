"""The team's tasks: admission, assignment, progress and end."""
