"""Which robot charges where and when."""
