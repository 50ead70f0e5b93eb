"""Shared parts of all commands: options, the terminal, and the list of commands."""
