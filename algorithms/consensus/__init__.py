"""Allocation of tasks without a coordinator: robots bid, and agree by the bids that they exchange."""
