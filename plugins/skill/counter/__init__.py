"""Counter: the paper's example of a skill that needs no hardware."""
