"""How long a field of motes lives."""
