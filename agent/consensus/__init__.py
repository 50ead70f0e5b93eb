"""What robots do about tasks while no coordinator is heard."""
