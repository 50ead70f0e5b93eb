"""Allocation of tasks without a coordinator: robots bid, and agree by what they hear of each other's bids."""
