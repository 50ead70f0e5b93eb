"""The team's language: the messages on the wire, and their meaning."""
