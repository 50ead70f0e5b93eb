"""Serial protocols of laser scanners: bytes to points, and points to bytes for the simulator."""
