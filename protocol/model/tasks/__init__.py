"""Tasks, objectives and halts as values."""
