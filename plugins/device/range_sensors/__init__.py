"""The ring of range sensors and the bump ring."""
