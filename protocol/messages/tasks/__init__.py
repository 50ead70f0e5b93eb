"""Messages about tasks: offers, costs, plans, rules, ballots."""
