"""SNwExploration: the robot is the relay between the mote network and the global one."""

import msgspec

from robrain.agent.plugin import Unit, external
from robrain.plugins.device.mote_base.interface import MoteBaseInterface
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tinyos import READING_TYPE, ActiveMessage, BadPacket, ReadingPayload
from robrain.protocol.wire.messages import MoteReading
from robrain.protocol.wire.publisher import Publisher
from robrain.protocol.wire.topics import MOTE_READING

MAX_MOTES = 4096
DM_PER_M = 10
CENTI = 100


class HeardMote(msgspec.Struct, frozen=True):
    """A mote as it was last heard."""

    mote: str
    readings: int
    rssi_dbm: float
    last_value: float


class SNwExploration(Unit):
    """Collects readings from the motes in reach and puts them on the team's wire."""

    def init(self) -> None:
        self._heard: dict[str, HeardMote] = {}
        self._publishers: dict[str, Publisher] = {}
        self._unreadable = 0

    def activate(self) -> None:
        self.env.observe(self.env.use("mote_base", MoteBaseInterface).heard, self._take)

    @external
    def motes(self) -> list[HeardMote]:
        """The motes heard so far, by name."""
        return [self._heard[name] for name in sorted(self._heard)]

    @external
    def unreadable(self) -> int:
        """Packets that said to be readings and were none."""
        return self._unreadable

    def _take(self, message: ActiveMessage) -> None:
        if message.type != READING_TYPE:
            return
        try:
            reading = ReadingPayload.unpack(message.payload)
        except BadPacket:
            self._unreadable += 1
            return
        name = f"m{reading.mote}"
        if name not in self._publishers:
            if len(self._publishers) >= MAX_MOTES:
                return
            self._publishers[name] = self.env.wire.publisher(MOTE_READING, mote=name)
        before = self._heard.get(name)
        value = reading.reading_centi / CENTI
        self._heard[name] = HeardMote(name, 1 + (before.readings if before is not None else 0), reading.rssi_dbm, value)
        self._publishers[name].put(
            MoteReading(
                mote=name,
                place=Point2D(reading.x_dm / DM_PER_M, reading.y_dm / DM_PER_M),
                quantity="temperature_c",
                value=value,
                voltage_v=reading.voltage_mv / 1000,
                rssi_dbm=reading.rssi_dbm,
                via=self.env.robot,
            )
        )
