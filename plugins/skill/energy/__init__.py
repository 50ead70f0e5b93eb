"""Energy: what work will cost, learned from what it did cost."""
