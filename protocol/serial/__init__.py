"""Serial lines: ports of this computer, and simulated ones over Zenoh."""
