"""The team's tasks: which there are, who does them, and what becomes of them."""
