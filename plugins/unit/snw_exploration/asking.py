"""Asking motes for stored readings, over a radio that loses requests and answers alike.

A mote listens for a moment after each packet that it sends, whether or not that packet is heard. So as long as it may
be answering it is asked again for what is missing by then. Where the link is weak, more is asked for at once, each
request is said several times, and when a mote was not heard at its time it is asked all the same.
"""

from collections.abc import Callable

import msgspec

from robrain.plugins.unit.snw_exploration.mote_record import MoteRecord
from robrain.protocol.clock import NS_PER_S, to_ns
from robrain.protocol.tinyos.payloads import DECI, REQUEST_SPAN, REQUEST_TYPE

SEEK_PERIODS = 6
"""A mote that has been silent for so many of its periods is out of reach."""
SEEK_EARLY_NS, SEEK_LATE_NS = to_ns(-0.3), to_ns(0.6)
"""When a mote may be listening, about the time of its next packet: two random back-offs and its listening."""
SEEK_EACH_NS = to_ns(0.1)
SEEK_MOTES = 3
"""So many are asked unheard: others need the air as well."""


class AskingParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How eagerly motes are asked; a base for the plugin's own."""

    request_span: int = 16
    request_patience_s: float = 1.5
    repeat_after_s: float = 0.12
    listens_s: float = 0.2
    """Time for which a mote listens after a packet."""
    answer_gap_s: float = 0.04
    """Time between two packets of an answer."""
    weak_dbm: float = -82.0
    """Signal strength below which a link counts as weak."""
    weak_copies: int = 3
    """Copies of a request on a weak link."""


class Asking:
    """Which motes owe an answer.

    Args:
        parameters: how eagerly they are asked.
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
        """Ask a mote that was just heard for what is missing; False if nothing is."""
        record.asked = record.window.request(self._span(record))
        if record.asked is None:
            return False
        record.asked_until_ns = now_ns + to_ns(self._parameters.request_patience_s)
        self._say(record, now_ns)
        return True

    def step(self, now_ns: int) -> None:
        """Ask again whom it may help."""
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
                # What it says, if it says anything, does not arrive; it listens for a moment after the last of it.
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
            self._say(record, now_ns)

    def _say(self, record: MoteRecord, now_ns: int) -> None:
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
