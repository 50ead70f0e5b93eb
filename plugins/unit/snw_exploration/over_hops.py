"""Requests, acknowledgements and duties for motes that a base station does not hear, by way of those that it hears.

A reading that other motes have passed on names the first of them, its mote's parent. From the parents follows the route
back, which each packet carries (`protocol/tinyos/routed`). The first mote of a route is spoken to when it is heard, as
any mote. On the way packets and answers may get lost: what has not had its effect `WAIT_NS` later is said again.
"""

from collections.abc import Callable

from robrain.plugins.unit.snw_exploration.mote_record import MoteRecord
from robrain.protocol.clock import to_ns
from robrain.protocol.tinyos.payloads import ACKNOWLEDGE_TYPE, DUTY_TYPE, REQUEST_TYPE, DutyPayload, ReadingPayload
from robrain.protocol.tinyos.routed import ROUTE_MAX, ROUTED_TYPE, SERIALS, RoutedPayload

WAIT_NS = to_ns(10.0)
"""Between two packets of one type to one mote, and until a missing reading counts as lost on the way (chosen)."""
FRESH_NS = to_ns(120.0)
"""For which a mote's parent is remembered, and a packet waits for the first mote of its route (chosen)."""
SPAN = 8
"""Readings that are asked for at once: motes have little room for what they pass on."""
AT_ONCE = 4
"""Packets that are given to one mote when it is heard."""
DUTY_TRIES = 20

Send = Callable[[int, int, bytes], None]
"""Puts a packet on the air: address, AM type, payload."""


class OverHops:
    """What is said over hops by one base station.

    Args:
        send: puts a packet on the air.
        acknowledge_every: readings that are acknowledged together, at least.

    """

    def __init__(self, send: Send, acknowledge_every: int) -> None:
        self.sent = 0
        """Routed packets."""
        self.given_up = 0
        """Duties that were not confirmed after `DUTY_TRIES`."""
        self._send = send
        self._acknowledge_every = acknowledge_every
        self._parents: dict[int, tuple[int | None, int]] = {}
        """By mote: the mote that passes its readings on, None if it is heard directly, and since when that is known."""
        self._waiting: dict[tuple[int, int], tuple[bytes, int]] = {}
        """By mote and AM type: what is to be said, and since when."""
        self._published_ns: dict[tuple[int, int], int] = {}
        self._lacking_ns: dict[int, int] = {}
        self._serial = 0

    def hear(self, mote: int, now_ns: int) -> None:
        """A mote was heard, and listens: give it what it is to pass on."""
        self._parents[mote] = None, now_ns
        if not self._waiting:
            return
        given = 0
        for (target, kind), (payload, since_ns) in list(self._waiting.items()):
            if now_ns - since_ns > FRESH_NS:
                del self._waiting[target, kind]
                continue
            route = self.route(target, now_ns)
            if route and route[0] == mote and given < AT_ONCE:
                given += 1
                del self._waiting[target, kind]
                self._say(route, kind, payload)

    def received_direct(self, record: MoteRecord, reading: ReadingPayload, now_ns: int) -> None:
        """A base station that does not ask motes in its own reach has heard one: send it what it is missing.

        Its readings are acknowledged already.
        """
        self._want_duty(record, reading, now_ns)
        self._want_missing(record, now_ns)
        self.hear(record.number, now_ns)

    def received_forwarded(self, record: MoteRecord, reading: ReadingPayload, parent: int, now_ns: int) -> None:
        """A mote's reading has come over others, and was noted in its window: decide what there is to say to the mote.

        Args:
            record: of the mote.
            reading: that has come.
            parent: number of the first mote that passed it on.
            now_ns: when.

        """
        self._parents[record.number] = parent, now_ns
        if record.window.is_newest(reading.sequence):
            record.window.mote_holds_from(reading.oldest)
        self._want_duty(record, reading, now_ns)
        self._want_missing(record, now_ns)
        complete = record.window.complete()
        if complete is not None and complete[1] >= self._acknowledge_every:
            self._want(record.number, ACKNOWLEDGE_TYPE, complete[0].pack(), now_ns)

    def route(self, mote: int, now_ns: int) -> tuple[int, ...] | None:
        """The motes on the way to a mote, itself last; None if no way is known, or only one that is too long."""
        way: list[int] = [mote]
        while True:
            known = self._parents.get(way[-1])
            if known is None or now_ns - known[1] > FRESH_NS:
                return None
            if known[0] is None:
                return tuple(reversed(way))
            if known[0] in way or len(way) > ROUTE_MAX:
                return None
            way.append(known[0])

    def _want_duty(self, record: MoteRecord, reading: ReadingPayload, now_ns: int) -> None:
        wanted_ds = record.wanted_period_ds
        if wanted_ds is None:
            return
        if reading.period_ds == wanted_ds:
            record.wanted_period_ds = None
            self._waiting.pop((record.number, DUTY_TYPE), None)
        elif record.duty_tries >= DUTY_TRIES:
            record.wanted_period_ds = None
            self.given_up += 1
        elif self._want(record.number, DUTY_TYPE, DutyPayload(wanted_ds).pack(), now_ns):
            record.duty_tries += 1

    def _want_missing(self, record: MoteRecord, now_ns: int) -> None:
        """Ask for what is missing for longer than readings take on their way."""
        request = record.window.request(SPAN)
        if request is None:
            record.is_asked_for = False
            self._lacking_ns.pop(record.number, None)
            self._waiting.pop((record.number, REQUEST_TYPE), None)
        elif record.is_asked_for or now_ns - self._lacking_ns.setdefault(record.number, now_ns) >= WAIT_NS:
            self._want(record.number, REQUEST_TYPE, request.pack(), now_ns)

    def _want(self, mote: int, kind: int, payload: bytes, now_ns: int) -> bool:
        """Have something said to a mote when the first mote of its route is heard; False if that was done just now."""
        at = mote, kind
        if at in self._waiting:
            self._waiting[at] = payload, self._waiting[at][1]
            return False
        if now_ns - self._published_ns.get(at, -WAIT_NS) < WAIT_NS:
            return False
        self._published_ns[at] = now_ns
        self._waiting[at] = payload, now_ns
        return True

    def _say(self, route: tuple[int, ...], kind: int, payload: bytes) -> None:
        first, *rest = route
        if not rest:
            self._send(first, kind, payload)
            return
        self._serial = (self._serial + 1) % SERIALS
        self.sent += 1
        self._send(first, ROUTED_TYPE, RoutedPayload(kind, self._serial, tuple(rest), payload).pack())
