"""What travels about sensor motes."""
