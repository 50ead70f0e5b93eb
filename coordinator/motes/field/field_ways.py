"""By which motes and gateways readings have come."""

from collections import Counter

from msgspec import UNSET

from robrain.coordinator.motes.mote_registry import MOTES_MAX
from robrain.protocol.wire.messages.motes.mote_field_messages import ForwarderCount, GatewayCount
from robrain.protocol.wire.messages.motes.mote_messages import MoteReading

FORWARDERS_TOLD = 16
GATEWAYS_MAX = 256


class FieldWays:
    """Counts the ways of readings."""

    def __init__(self) -> None:
        self.forwarded = 0
        """Readings that have come over other motes."""
        self._hops = 0
        self._first: Counter[str] = Counter()
        self._gateways: dict[str, MoteReading] = {}
        self._by_gateway: Counter[str] = Counter()

    def note(self, reading: MoteReading, *, is_new: bool) -> None:
        """A reading has come; whether for the first time."""
        if reading.waiting is not UNSET and (reading.via in self._gateways or len(self._gateways) < GATEWAYS_MAX):
            self._gateways[reading.via] = reading
            self._by_gateway[reading.via] += is_new
        if reading.hops and reading.forwarder and is_new:
            self.forwarded += 1
            self._hops += reading.hops
            if reading.forwarder in self._first or len(self._first) < MOTES_MAX:
                self._first[reading.forwarder] += 1

    @property
    def mean_hops(self) -> float:
        """Mean number of motes that have passed such a reading on; 0 if there is none."""
        return round(self._hops / self.forwarded, 3) if self.forwarded else 0.0

    def forwarders(self) -> list[ForwarderCount]:
        """Motes that were most often the first to pass a reading on, most readings first."""
        ranked = sorted(self._first.items(), key=lambda one: (-one[1], one[0]))
        return [ForwarderCount(mote=mote, readings=readings) for mote, readings in ranked[:FORWARDERS_TOLD]]

    def gateways(self) -> list[GatewayCount]:
        """The gateways that have told readings, by name."""
        return [
            GatewayCount(
                name=name,
                readings=self._by_gateway[name],
                waiting=latest.waiting or 0,
                dropped=latest.dropped or 0,
                heard_ns=latest.stamp_ns,
            )
            for name, latest in sorted(self._gateways.items())
        ]
