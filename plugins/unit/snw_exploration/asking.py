"""Asking motes for stored readings, over a radio that loses requests and answers alike.

A mote listens for a moment after each packet that it sends, whether or not that packet is received. While it may be
answering, it is asked again for the readings still missing. Where the link is weak, each request asks for more and is
repeated. A mote whose packet was not received on time is asked nevertheless.
"""

from collections.abc import Callable
from typing import Annotated

from msgspec import Meta

from robrain.plugins.unit.snw_exploration.mote_record import MoteRecord
from robrain.protocol.clock import NS_PER_S, to_ns
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import Positive, PositiveInt
from robrain.protocol.tinyos.payloads import (
    ACKNOWLEDGE_TYPE,
    DECI,
    DUTY_TYPE,
    REQUEST_SPAN,
    REQUEST_TYPE,
    ROUTE_MAX,
    ROUTED_TYPE,
    SERIALS,
    DutyPayload,
    ReadingPayload,
    RoutedPayload,
)

WAIT_NS = to_ns(10.0)
"""Between two packets of one type to one mote, and until a missing reading counts as lost (chosen)."""
FRESH_NS = to_ns(120.0)
"""For which a mote's parent is remembered, and a packet waits for the first mote of its route (chosen)."""
SPAN = 8
"""Readings that are requested at once: motes have little room for forwarded packets."""
AT_ONCE = 4
"""Packets that are given to one mote when it is received."""
DUTY_TRIES = 20

Send = Callable[[int, int, bytes], None]
"""Puts a packet on the air: address, AM type, payload."""


class OverHops:
    """Packets of one base station over hops.

    Args:
        send: puts a packet on the air.
        acknowledge_every: readings that are acknowledged together, at least.

    """

    def __init__(self, send: Send, acknowledge_every: int) -> None:
        self.sent = 0
        """Routed packets."""
        self._send = send
        self._acknowledge_every = acknowledge_every
        self._parents: dict[int, tuple[int | None, int]] = {}
        """By mote: the mote that passes its readings on, None if it is received directly, and since when this is known.
        """
        self._waiting: dict[tuple[int, int], tuple[bytes, int]] = {}
        """By mote and AM type: the payload to send, and since when."""
        self._published_ns: dict[tuple[int, int], int] = {}
        self._lacking_ns: dict[int, int] = {}
        self._serial = 0

    def record(self, mote: int, now_ns: int) -> None:
        """A mote was received, and listens: give it the packets to pass on."""
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
                self._transmit(route, kind, payload)

    def received_direct(self, record: MoteRecord, reading: ReadingPayload, now_ns: int) -> None:
        """A base station that does not ask motes in its reach has received one: request its missing readings.

        Its readings are acknowledged already.
        """
        self._want_duty(record, reading, now_ns)
        self._want_missing(record, now_ns)
        self.record(record.number, now_ns)

    def received_forwarded(self, record: MoteRecord, reading: ReadingPayload, parent: int, now_ns: int) -> None:
        """A mote's reading has come over others, and is in its window: decide on the packets to the mote.

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
        """The motes on the route to a mote, itself last; None if no route is known, or only a too long one."""
        route: list[int] = [mote]
        while True:
            known = self._parents.get(route[-1])
            if known is None or now_ns - known[1] > FRESH_NS:
                return None
            if known[0] is None:
                return tuple(reversed(route))
            if known[0] in route or len(route) > ROUTE_MAX:
                return None
            route.append(known[0])

    def _want_duty(self, record: MoteRecord, reading: ReadingPayload, now_ns: int) -> None:
        record.forget_duty(reading.period_ds, DUTY_TRIES)
        if record.wanted_period_ds is None:
            self._waiting.pop((record.number, DUTY_TYPE), None)
        elif self._want(record.number, DUTY_TYPE, DutyPayload(record.wanted_period_ds).pack(), now_ns):
            record.duty_tries += 1

    def _want_missing(self, record: MoteRecord, now_ns: int) -> None:
        """Request readings that are missing for longer than their transport takes."""
        request = record.window.request(SPAN)
        if request is None:
            record.is_asked_for = False
            self._lacking_ns.pop(record.number, None)
            self._waiting.pop((record.number, REQUEST_TYPE), None)
        elif record.is_asked_for or now_ns - self._lacking_ns.setdefault(record.number, now_ns) >= WAIT_NS:
            self._want(record.number, REQUEST_TYPE, request.pack(), now_ns)

    def _want(self, mote: int, kind: int, payload: bytes, now_ns: int) -> bool:
        """Queue a packet to a mote for the reception of the first mote of its route; False if one was just queued."""
        at = mote, kind
        if at in self._waiting:
            self._waiting[at] = payload, self._waiting[at][1]
            return False
        if now_ns - self._published_ns.get(at, -WAIT_NS) < WAIT_NS:
            return False
        self._published_ns[at] = now_ns
        self._waiting[at] = payload, now_ns
        return True

    def _transmit(self, route: tuple[int, ...], kind: int, payload: bytes) -> None:
        first, *rest = route
        if not rest:
            self._send(first, kind, payload)
            return
        self._serial = (self._serial + 1) % SERIALS
        self.sent += 1
        self._send(first, ROUTED_TYPE, RoutedPayload(kind, self._serial, tuple(rest), payload).pack())


SEEK_PERIODS = 6
"""Number of silent periods after which a mote is out of reach."""
SEEK_EARLY_NS, SEEK_LATE_NS = to_ns(-0.3), to_ns(0.6)
"""When a mote may be listening, about the time of its next packet: two random back-offs and its listening."""
SEEK_EACH_NS = to_ns(0.1)
SEEK_MOTES = 3
"""Number of unreceived motes that are asked: others need the air as well."""


class AskingParameters(Checked, frozen=True, forbid_unknown_fields=True):
    """Rates of requests to motes; a base for the plugin's parameters."""

    request_span: Annotated[int, Meta(ge=1, le=REQUEST_SPAN)] = 16
    request_patience_s: Positive = 1.5
    repeat_after_s: Positive = 0.12
    listens_s: Positive = 0.2
    """Time for which a mote listens after a packet."""
    answer_gap_s: Positive = 0.04
    """Time between two packets of an answer."""
    weak_dbm: float = -82.0
    """Signal strength below which a link counts as weak."""
    weak_copies: PositiveInt = 3
    """Copies of a request on a weak link."""


class Asking:
    """Open requests to motes.

    Args:
        parameters: rates of the requests.
        send: puts a packet on the air: address, AM type, payload.

    """

    def __init__(self, parameters: AskingParameters, send: Callable[[int, int, bytes], None]) -> None:
        self.requests = 0
        """Packets that were sent."""
        self._parameters = parameters
        self._send = send
        self._repeat_ns = to_ns(parameters.repeat_after_s)
        self._listens_ns, self._gap_ns = to_ns(parameters.listens_s), to_ns(parameters.answer_gap_s)
        self._owing: dict[int, MoteRecord] = {}

    def ask(self, record: MoteRecord, now_ns: int) -> bool:
        """Request the missing readings of a mote that was just received; False if none is missing."""
        record.asked = record.window.request(self._span(record))
        if record.asked is None:
            return False
        record.asked_until_ns = now_ns + to_ns(self._parameters.request_patience_s)
        self._transmit(record, now_ns)
        return True

    def step(self, now_ns: int) -> None:
        """Repeat the requests that the mote may still answer, and forget the others."""
        if not self._owing:
            return
        sought = 0
        for number, record in list(self._owing.items()):
            quiet_ns = now_ns - record.stamp_ns
            if record.asked is None:
                del self._owing[number]
            elif quiet_ns < self._repeat_ns:
                continue
            elif quiet_ns <= self._listens_ns + self._gap_ns * record.asked.wanted.bit_count():
                # The mote's packets, if any, do not arrive; it listens briefly after the last one.
                if now_ns - record.spoke_ns >= self._repeat_ns:
                    self._ask_again(record, now_ns)
            elif sought < SEEK_MOTES and self._is_weak(record) and _is_near(record, now_ns):
                sought += 1
                if _may_listen(record, now_ns) and now_ns - record.spoke_ns >= SEEK_EACH_NS:
                    self._ask_again(record, now_ns)
            else:
                del self._owing[number]

    def _ask_again(self, record: MoteRecord, now_ns: int) -> None:
        record.asked = record.window.request(self._span(record))
        if record.asked is not None:
            self._transmit(record, now_ns)

    def _transmit(self, record: MoteRecord, now_ns: int) -> None:
        assert record.asked is not None
        self._owing[record.number] = record
        record.spoke_ns = now_ns
        packet = record.asked.pack()
        for _ in range(self._parameters.weak_copies if self._is_weak(record) else 1):
            self.requests += 1
            self._send(record.number, REQUEST_TYPE, packet)

    def _span(self, record: MoteRecord) -> int:
        return REQUEST_SPAN if self._is_weak(record) else self._parameters.request_span

    def _is_weak(self, record: MoteRecord) -> bool:
        return record.latest is not None and record.latest.rssi_dbm < self._parameters.weak_dbm


def _period_ns(record: MoteRecord) -> int:
    return record.latest.period_ds * (NS_PER_S // DECI) if record.latest is not None else 0


def _is_near(record: MoteRecord, now_ns: int) -> bool:
    return now_ns - record.live_ns <= SEEK_PERIODS * _period_ns(record)


def _may_listen(record: MoteRecord, now_ns: int) -> bool:
    """Whether it is about the time of a packet that its period lets expect."""
    period_ns, since_ns = _period_ns(record), now_ns - record.live_ns
    off_ns = (since_ns + period_ns // 2) % period_ns - period_ns // 2
    return since_ns > period_ns // 2 and SEEK_EARLY_NS <= off_ns <= SEEK_LATE_NS
