"""Serial lines, and the protocols of laser scanners on them: bytes to points, and points to bytes for the simulator."""
