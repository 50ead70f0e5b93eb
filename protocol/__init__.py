"""The team's language: what passes on the wire, and what it means."""
