"""Which coordinator leads: one that is alone, or the one that robots have elected."""
