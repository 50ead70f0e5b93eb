"""The team's side: who is there, what is known, who does what; recordings and the dashboard."""
