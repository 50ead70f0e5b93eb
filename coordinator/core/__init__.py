"""What every part of a coordinator builds on: the team, its tasks and plans, and the parts themselves."""
