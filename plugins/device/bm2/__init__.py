"""BM²: the battery manager on the CAN bus."""
