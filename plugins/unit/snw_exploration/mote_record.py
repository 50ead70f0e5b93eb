"""All that a robot knows of one mote."""

from robrain.plugins.unit.snw_exploration.interface import HeardMote
from robrain.plugins.unit.snw_exploration.sequence_window import SequenceWindow
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.tinyos.payloads import CENTI, DECI, NO_PLACE, ReadingPayload, RequestPayload
from robrain.protocol.wire.publisher import Publisher


class MoteRecord:
    """One mote: what has arrived of it, how it is heard, and what is to be said to it.

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
        """The last packet heard by this robot; None as long as only others have brought in its readings."""
        self.latest_live: ReadingPayload | None = None
        self.publisher: Publisher | None = None
        self.readings = 0
        self.is_asked_for = False
        """Somebody wants its stored readings."""
        self.asked: RequestPayload | None = None
        """The request that it is answering."""
        self.asked_until_ns = 0
        self.spoke_ns = 0
        self.live_ns = 0
        """When it was asked last."""
        self.wanted_period_ds: int | None = None
        self.wanted_stamp_ns = -1
        self.duty_tries = 0
        self.stamp_ns = 0
        """When this robot heard it last."""
        self._heard_from: Point2D | None = None
        self._rssi_sum_dbm = 0.0
        self._packets = 0

    def note_heard(self, reading: ReadingPayload, stamp_ns: int, heard_from: Point2D | None) -> None:
        """One packet of it was heard by this robot."""
        self.latest = reading
        if self.latest_live is None or reading.age_ds == 0:
            self.latest_live = reading
            self.live_ns = stamp_ns
        self.stamp_ns = stamp_ns
        self._heard_from = heard_from
        self._rssi_sum_dbm += reading.rssi_dbm
        self._packets += 1

    def note_answer(self, sequence: int) -> None:
        """A stored reading has come. After the last one of a request no more will, whatever was lost before it."""
        if self.asked is not None and sequence == self.asked.sequences()[-1]:
            self.asked = None

    def want_period(self, period_ds: int, stamp_ns: int) -> bool:
        """Somebody wants a duty; False if a later wish is known."""
        if stamp_ns < self.wanted_stamp_ns:
            return False
        self.wanted_period_ds, self.wanted_stamp_ns, self.duty_tries = period_ds, stamp_ns, 0
        return True

    def as_heard(self) -> HeardMote | None:
        """For the table; None if this robot has never heard it."""
        if self.latest is None or self.latest_live is None:
            return None
        return HeardMote(
            mote=self.name,
            place=place_of(self.latest),
            rssi_dbm=self.latest.rssi_dbm,
            mean_rssi_dbm=self._rssi_sum_dbm / self._packets,
            stamp_ns=self.stamp_ns,
            heard_from=self._heard_from,
            readings=self.readings,
            missing=self.window.missing,
            period_s=self.latest.period_ds / DECI,
            voltage_v=self.latest.voltage_mv / 1000,
            last_value=self.latest_live.value_centi / CENTI,
        )


def place_of(reading: ReadingPayload) -> Point2D | None:
    """Where a mote says that it lies, arena frame; None if it does not know."""
    if reading.x_dm == NO_PLACE and reading.y_dm == NO_PLACE:
        return None
    return Point2D(reading.x_dm / DECI, reading.y_dm / DECI)
