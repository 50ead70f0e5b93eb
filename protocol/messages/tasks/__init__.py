"""What travels about tasks: offers, costs, plans, rules, ballots."""
