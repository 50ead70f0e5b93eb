"""Task allocation: assigns jobs to robots, orders them and accounts for energy. Pure functions, no wire."""
