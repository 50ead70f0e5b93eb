"""The messages of the wire, by subject."""
