"""What travels of maps, and how their patches are packed."""
