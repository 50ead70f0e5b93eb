"""The other robots of the team, as they tell of themselves."""
