"""The team's side: presence, knowledge and allocation; recordings and the dashboard."""
