"""Base of all parts of a coordinator: the team, its tasks and plans, and the parts themselves."""
