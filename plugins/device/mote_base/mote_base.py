"""Base station of the mote network: TinyOS packets that come over the wire."""

import msgspec

from robrain.agent.event import Event
from robrain.agent.plugin import Device, external
from robrain.plugins.device.mote_base.interface import MoteBaseInterface
from robrain.protocol.model.tinyos import ActiveMessage, BadPacket
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.topics import ARENA_RADIO_RX


class PacketCounters(msgspec.Struct, frozen=True):
    """What the base station has heard."""

    packets: int
    malformed: int
    dropped: int


class MoteBase(Device):
    """Hands on each packet that the radio hears."""

    interface = MoteBaseInterface
    period_s = 0.1
    heard = Event[ActiveMessage]()

    def init(self) -> None:
        self._inbox = Inbox()
        self._packets = self._malformed = 0

    def activate(self) -> None:
        self.env.wire.subscribe(self._inbox, ARENA_RADIO_RX, robot=self.env.robot)

    def step(self) -> None:
        for received in self._inbox.drain():
            try:
                message = ActiveMessage.unpack(received.message)
            except BadPacket:
                self._malformed += 1
                continue
            self._packets += 1
            self.heard.notify(message)

    @external
    def counters(self) -> PacketCounters:
        """Packets heard, malformed ones, and those dropped because too many came at once."""
        return PacketCounters(self._packets, self._malformed, self._inbox.dropped)
