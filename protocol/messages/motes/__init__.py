"""Messages about sensor motes."""
