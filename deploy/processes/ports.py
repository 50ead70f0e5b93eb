"""Ports of this machine."""

import socket


def free_or(preferred: int) -> int:
    """The preferred port if nobody listens on it on loopback, else 0 for a free one."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", preferred))
        except OSError:
            return 0
    return preferred
