"""Battery manager node: voltage, current and temperature over CAN."""

import can
import msgspec

from robrain.agent.plugin import Device, external
from robrain.plugins.device.bm2.interface import BatteryMeasurement, Bm2Interface
from robrain.protocol.can.frames import BadFrame, codec
from robrain.protocol.wire.clock import NS_PER_S


class Bm2(Device):
    """Reads what the battery manager measures."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """python-can's interface and channel."""

        interface: str = "zenoh"
        channel: str = "can0"

    interface = Bm2Interface
    period_s = 0.2
    parameters: Parameters

    def init(self) -> None:
        self._bus: can.BusABC | None = None
        self._status = codec("BatteryStatus")
        self._latest: BatteryMeasurement | None = None
        self._rejected = 0

    def activate(self) -> None:
        filters: can.typechecking.CanFilters = [
            {"can_id": self._status.arbitration_id, "can_mask": 0x7FF, "extended": False}
        ]
        self._bus = self.env.open_can(self.parameters.interface, self.parameters.channel, can_filters=filters)

    def step(self) -> None:
        if self._bus is None:
            return
        while (frame := self._bus.recv(timeout=0)) is not None:
            try:
                signals = self._status.unpack(frame)
            except BadFrame:
                self._rejected += 1
                continue
            self._latest = BatteryMeasurement(
                round(frame.timestamp * NS_PER_S),
                signals["voltage_v"],
                signals["current_a"],
                signals["temperature_c"],
            )

    def deactivate(self) -> None:
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = None

    @external
    def latest(self) -> BatteryMeasurement | None:
        """The last measurement; null before the first."""
        return self._latest
