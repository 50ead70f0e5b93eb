"""How many packets a base station may say, and when it says too many."""

from robrain.protocol.wire.clock import NS_PER_S


class FloodGuard:
    """Lets so many packets through in each second, and knows whether there were more.

    Args:
        limit: packets in a second.

    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.since_ns: int | None = None
        """When the flood began; None while there is none."""
        self._second_ns = 0
        self._count = 0

    def admit(self, arrived: int, now_ns: int) -> int:
        """How many of the packets that have arrived go on. A flood ends with the first second that keeps the limit."""
        if now_ns - self._second_ns >= NS_PER_S:
            if self._count <= self.limit:
                self.since_ns = None
            self._second_ns, self._count = now_ns, 0
        room = max(0, self.limit - self._count)
        self._count += arrived
        if self._count > self.limit and self.since_ns is None:
            self.since_ns = now_ns
        return min(arrived, room)
