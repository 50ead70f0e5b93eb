"""A robot's record of one mote, such as the numbers of its last readings that have arrived."""

from collections import deque
from collections.abc import Callable

import msgspec

from robrain.plugins.unit.snw_exploration.interface import ReceivedMote
from robrain.protocol.clock import to_ns
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.messages.motes.mote_messages import MoteReading
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.tinyos.payloads import (
    CENTI,
    DECI,
    NO_PLACE,
    REQUEST_SPAN,
    SEQUENCES,
    ReadingPayload,
    RequestPayload,
    SequenceRange,
    sequences_after,
)
from robrain.protocol.wire.endpoint import Endpoint

FORWARD_NS = to_ns(0.05)
"""Interval at which a stored reading of each mote is forwarded: within a Zenoh lease fewer than a key's cache holds."""
MOTES_AT_ONCE = 16
"""Motes of which one is forwarded at a time: at most 320 readings a second in all."""

Put = Callable[[MoteReading], object]


class ReadingStore:
    """Readings that a gateway has received and not yet published.

    Args:
        wire: the gateway's endpoint.
        capacity: most readings that it keeps. When it is full, the oldest of the mote with the most is dropped.
        put: puts a reading on the wire.

    """

    def __init__(self, wire: Endpoint, capacity: int, put: Put) -> None:
        self.dropped = 0
        """Readings dropped for lack of room."""
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

    def publish(self, reading: MoteReading) -> None:
        """Store a received reading that the team does not know."""
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
        """Check whether the network is there, and forward due readings."""
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


RESTART_BACK = 16
"""A mote whose live readings fall back by more than this has restarted; less is an old packet that comes late."""


class SequenceWindow:
    """Tracks one mote's sequence numbers across their wrap.

    Args:
        size: how many of the last numbers are tracked.

    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._newest: int | None = None
        """Without wrap."""
        self._oldest = 0
        """The lowest number that the mote may still have."""
        self._have = 0
        """Bit i: whether `newest` − i has arrived."""

    @property
    def missing(self) -> int:
        """Readings that the mote may still have and that have not arrived."""
        return self._lacking().bit_count()

    def add(self, sequence: int, *, is_live: bool = True) -> bool:
        """Add an arrived reading; returns whether it is new.

        Args:
            sequence: its number, 16 bits.
            is_live: it was just sensed, so none can be newer.

        """
        number = self._number(sequence)
        if self._newest is None or (is_live and number < self._newest - RESTART_BACK):
            self._newest, self._oldest, self._have = sequence, sequence, 1
            return True
        ahead = number - self._newest
        if ahead > 0:
            self._newest = number
            self._have = ((self._have << ahead) if ahead < self._size else 0) & ((1 << self._size) - 1) | 1
            self._oldest = max(self._oldest, number - self._size + 1)
            return True
        bit = 1 << -ahead
        if -ahead >= self._size or self._have & bit:
            return False
        self._have |= bit
        self._oldest = min(self._oldest, number)
        return True

    def is_newest(self, sequence: int) -> bool:
        """Whether none that has arrived is newer."""
        return self._newest is not None and sequence == self._newest % SEQUENCES

    def mote_holds_from(self, sequence: int) -> None:
        """The mote reports its oldest stored reading."""
        if self._newest is not None:
            number = min(self._number(sequence), self._newest)
            self._oldest = max(number, self._newest - self._size + 1)

    def request(self, span: int) -> RequestPayload | None:
        """The oldest readings that are missing, out of `span` numbers in a row; None if none is missing."""
        lacking = self._lacking()
        if not lacking:
            return None
        assert self._newest is not None
        first = lacking.bit_length() - 1
        last = max(0, first - min(span, REQUEST_SPAN) + 1)
        oldest_first = format(lacking >> last, "b")
        return RequestPayload((self._newest - first) % SEQUENCES, int(oldest_first[::-1], 2))

    def lacks(self, request: RequestPayload) -> bool:
        """Whether a part of a request is still missing."""
        if self._newest is None:
            return False
        lacking, newest = self._lacking(), self._newest
        return any(
            number <= newest and lacking >> (newest - number) & 1 for number in map(self._number, request.sequences())
        )

    def complete(self) -> tuple[SequenceRange, int] | None:
        """The readings in a row, from the oldest that the mote has, that have all arrived, and how many they are."""
        if self._newest is None:
            return None
        count = self._newest - self._oldest + 1 - self._lacking().bit_length()
        return (_range(self._oldest, self._oldest + count - 1), count) if count > 0 else None

    def _lacking(self) -> int:
        if self._newest is None:
            return 0
        return ~self._have & ((1 << (self._newest - self._oldest + 1)) - 1)

    def _number(self, sequence: int) -> int:
        newest = self._newest if self._newest is not None else sequence
        return newest + sequences_after(sequence, newest % SEQUENCES)


def _range(first: int, last: int) -> SequenceRange:
    return SequenceRange(first % SEQUENCES, last % SEQUENCES)


class MoteRecord:
    """One mote: its arrived readings, its reception, and the packets to send to it.

    Args:
        name: on the wire.
        number: on the air.
        window: of the last sequence numbers, how many are followed.

    """

    def __init__(self, name: str, number: int, window: int) -> None:
        self.name = name
        self.number = number
        self.window = SequenceWindow(window)
        self.latest: ReadingPayload | None = None
        """The last packet received by this robot; None while only others have provided its readings."""
        self.latest_live: ReadingPayload | None = None
        self.publisher: Publisher | None = None
        self.readings = 0
        self.is_asked_for = False
        """Its stored readings were requested."""
        self.asked: RequestPayload | None = None
        """The request that the mote is answering."""
        self.asked_until_ns = 0
        self.live_ns = 0
        self.spoke_ns = 0
        """Time of the last request."""
        self.wanted_period_ds: int | None = None
        self.wanted_stamp_ns = -1
        self.duty_tries = 0
        self.stamp_ns = 0
        """Time of the last packet that this robot received from the mote."""
        self._received_from: Point2D | None = None
        self._rssi_sum_dbm = 0.0
        self._packets = 0

    def record_packet(self, reading: ReadingPayload, stamp_ns: int, received_from: Point2D | None) -> None:
        """Record one packet that this robot received from the mote."""
        self.latest = reading
        if self.latest_live is None or reading.age_ds == 0:
            self.latest_live = reading
            self.live_ns = stamp_ns
        self.stamp_ns = stamp_ns
        self._received_from = received_from
        self._rssi_sum_dbm += reading.rssi_dbm
        self._packets += 1

    def record_answer(self, sequence: int) -> None:
        """Record that a stored reading has arrived.

        The last reading of a request ends it, even if earlier ones were lost.
        """
        if self.asked is not None and sequence == self.asked.sequences()[-1]:
            self.asked = None

    def want_period(self, period_ds: int, stamp_ns: int) -> bool:
        """Request a duty; False if a later request is known."""
        if stamp_ns < self.wanted_stamp_ns:
            return False
        self.wanted_period_ds, self.wanted_stamp_ns, self.duty_tries = period_ds, stamp_ns, 0
        return True

    def forget_duty(self, period_ds: int, tries_max: int) -> bool:
        """Forget a requested duty that the mote has, or that was sent this often; returns whether it was given up."""
        has_it = period_ds == self.wanted_period_ds
        is_given_up = not has_it and self.wanted_period_ds is not None and self.duty_tries >= tries_max
        if has_it or is_given_up:
            self.wanted_period_ds = None
        return is_given_up

    def as_received(self) -> ReceivedMote | None:
        """Entry of the table; None if this robot has never received it."""
        if self.latest is None or self.latest_live is None:
            return None
        return ReceivedMote(
            mote=self.name,
            place=place_of(self.latest),
            rssi_dbm=self.latest.rssi_dbm,
            mean_rssi_dbm=self._rssi_sum_dbm / self._packets,
            stamp_ns=self.stamp_ns,
            received_at=self._received_from,
            readings=self.readings,
            missing=self.window.missing,
            period_s=self.latest.period_ds / DECI,
            voltage_v=self.latest.voltage_mv / 1000,
            last_value=self.latest_live.value_centi / CENTI,
        )


def place_of(reading: ReadingPayload) -> Point2D | None:
    """Reported place of a mote, arena frame; None if it does not know."""
    if reading.x_dm == NO_PLACE and reading.y_dm == NO_PLACE:
        return None
    return Point2D(reading.x_dm / DECI, reading.y_dm / DECI)
