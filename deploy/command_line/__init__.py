"""What all commands share: options, the terminal, and how commands are listed."""
