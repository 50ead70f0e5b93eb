"""Store and forward: a gateway keeps readings while the team's network is away, and forwards them once it is back.

The network counts as there while the coordinator's token is seen. What is put in the moments before its loss is noticed
is kept by the wire itself, which sends the last samples of a lossless key again. So that this suffices, the readings of
one mote are forwarded at a limited rate.
"""

from collections import deque
from collections.abc import Callable

import msgspec

from robrain.protocol.clock import to_ns
from robrain.protocol.messages.motes.mote_messages import MoteReading
from robrain.protocol.table.topics import COORDINATOR_ALIVE
from robrain.protocol.wire.endpoint import Endpoint

FORWARD_NS = to_ns(0.05)
"""Interval at which a stored reading of each mote is forwarded: within a Zenoh lease fewer than a key's cache holds."""
MOTES_AT_ONCE = 16
"""Motes of which one is forwarded at a time: at most 320 readings a second in all."""

Put = Callable[[MoteReading], object]


class ReadingStore:
    """What a gateway has heard and not yet told.

    Args:
        wire: the gateway's endpoint.
        capacity: most readings that it keeps. When it is full, the oldest of the mote with the most is dropped.
        put: puts a reading on the wire.

    """

    def __init__(self, wire: Endpoint, capacity: int, put: Put) -> None:
        self.dropped = 0
        """Readings that there was no room for."""
        self.waiting = 0
        """Readings that are stored."""
        self._coordinators = wire.watch(COORDINATOR_ALIVE)
        self._capacity = capacity
        self._put = put
        self._stored: dict[str, deque[MoteReading]] = {}
        """By mote; those whose turn it is are first."""
        self._forward_ns = 0

    @property
    def is_up(self) -> bool:
        """Whether the team's network is there, as of the last step."""
        return bool(self._coordinators.present)

    def tell(self, reading: MoteReading) -> None:
        """A reading that the team does not know has been heard."""
        if self.is_up and reading.mote not in self._stored:
            self._publish_now(reading)
            return
        self._stored.setdefault(reading.mote, deque()).append(reading)
        self.waiting += 1
        if self.waiting > self._capacity:
            self.waiting -= 1
            self.dropped += 1
            most = max(self._stored, key=lambda mote: len(self._stored[mote]))
            self._stored[most].popleft()
            if not self._stored[most]:
                del self._stored[most]

    def step(self, now_ns: int) -> None:
        """See whether the network is there, and forward what is due."""
        if self._coordinators.arrived:
            self._coordinators.changes()
        if not self._stored or not self.is_up or now_ns < self._forward_ns:
            return
        self._forward_ns = now_ns + FORWARD_NS
        for mote in list(self._stored)[:MOTES_AT_ONCE]:
            readings = self._stored.pop(mote)
            self.waiting -= 1
            self._publish_now(readings.popleft())
            if readings:
                self._stored[mote] = readings  # behind the others

    def _publish_now(self, reading: MoteReading) -> None:
        self._put(msgspec.structs.replace(reading, waiting=self.waiting, dropped=self.dropped))
