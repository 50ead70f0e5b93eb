"""`robrain vda5050`: vehicles of other vendors in a team, and a team's robots as vehicles, by VDA 5050."""
