"""Any executable as a plugin."""
