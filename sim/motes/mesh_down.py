"""Packets that base stations send to motes out of reach, passed on from mote to mote along the route that they name.

Each hop is acknowledged and repeated like a reading on its way up. What `tries` packets could not hand over is dropped
and counted: the base station misses the answer and sends it again, by another route if readings come by another one.
"""

import heapq
from collections.abc import Callable, Mapping

import msgspec

from robrain.protocol.tinyos.packet import ActiveMessage, BadPacket
from robrain.protocol.tinyos.routed import RoutedPayload
from robrain.sim.motes.mesh_spec import MeshSpec

SEEN = 16
"""Routed packets that a mote remembers, to pass on each once."""

Hand = Callable[[int, int, Callable[[], bool]], bool]
"""Sends a packet from a mote to another one, which takes it by the function; returns whether that was acknowledged."""


class DownCounters(msgspec.Struct):
    """What became of routed packets."""

    taken: int = 0
    """From base stations."""
    passed_on: int = 0
    """By a mote, to the next one."""
    delivered: int = 0
    """To the mote that they were for."""
    undelivered: int = 0
    """Dropped because a next mote was dead, out of reach or never acknowledged."""
    refused: int = 0
    """Not taken for lack of room."""


class _Waiting(msgspec.Struct):
    """A routed packet at a mote."""

    at: int
    """Index of the mote."""
    routed: RoutedPayload
    failed: int = 0


class RoutedDown:
    """What motes hold of routed packets.

    Args:
        spec: tries, room and interval of waking.
        index_of: index of each mote by its number.
        hand: sends on a hop.
        deliver: gives a mote the packet that is for it.
        wake_ticks: interval of waking.

    """

    def __init__(
        self,
        spec: MeshSpec,
        index_of: Mapping[int, int],
        hand: Hand,
        deliver: Callable[[int, ActiveMessage], None],
        wake_ticks: int,
    ) -> None:
        self.counters = DownCounters()
        self._spec = spec
        self._index_of = index_of
        self._hand = hand
        self._deliver = deliver
        self._wake_ticks = wake_ticks
        self._due: list[tuple[int, int, _Waiting]] = []
        self._held: dict[int, int] = {}
        """Packets at each mote that holds any."""
        self._seen: dict[int, dict[tuple[int, int, int, bytes], None]] = {}
        self._number = 0

    def step(self, tick: int) -> None:
        """Send what is due."""
        while self._due and self._due[0][0] <= tick:
            self._pass_on(heapq.heappop(self._due)[2], tick)

    def from_station(self, index: int, payload: bytes, tick: int) -> None:
        """A mote has heard a routed packet of a base station; one that cannot be is left alone."""
        try:
            routed = RoutedPayload.unpack(payload)
        except BadPacket:
            return
        self.counters.taken += self._take(index, routed, tick)

    def _take(self, index: int, routed: RoutedPayload, tick: int) -> bool:
        """A mote hears a packet that it is to pass on; whether it acknowledges it."""
        if self._held.get(index, 0) >= self._spec.queue:
            self.counters.refused += 1
            return False
        if not self._has_seen(index, routed):
            self._held[index] = self._held.get(index, 0) + 1
            self._wait(_Waiting(index, routed), tick)
        return True

    def _pass_on(self, waiting: _Waiting, tick: int) -> None:
        routed = waiting.routed
        to = self._index_of.get(routed.route[0])
        if to is not None and self._hand(waiting.at, to, lambda: self._arrive(to, routed, tick)):
            self.counters.passed_on += 1
        else:
            waiting.failed += 1
            if to is not None and waiting.failed < self._spec.tries:
                self._wait(waiting, tick)
                return
            self.counters.undelivered += 1
        self._held[waiting.at] -= 1

    def _arrive(self, index: int, routed: RoutedPayload, tick: int) -> bool:
        rest = msgspec.structs.replace(routed, route=routed.route[1:])
        if rest.route:
            return self._take(index, rest, tick)
        if not self._has_seen(index, rest):
            self.counters.delivered += 1
            number = routed.route[0]
            self._deliver(index, ActiveMessage(type=routed.kind, payload=routed.inner, source=0, destination=number))
        return True

    def _wait(self, waiting: _Waiting, tick: int) -> None:
        self._number += 1
        heapq.heappush(self._due, (tick + self._wake_ticks, self._number, waiting))

    def _has_seen(self, index: int, routed: RoutedPayload) -> bool:
        seen = self._seen.setdefault(index, {})
        key = routed.kind, routed.serial, routed.route[-1] if routed.route else -1, routed.inner
        if key in seen:
            return True
        seen[key] = None
        if len(seen) > SEEN:
            del seen[next(iter(seen))]
        return False
