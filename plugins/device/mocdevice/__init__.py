"""The motor controller on the CAN bus."""
