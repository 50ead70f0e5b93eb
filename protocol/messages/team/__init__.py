"""Messages about the team as a whole, its coordinator and its tools."""
