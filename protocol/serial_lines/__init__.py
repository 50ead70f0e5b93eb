"""Serial lines: those of the computer, and those of the simulator."""
