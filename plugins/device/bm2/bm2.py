"""Battery manager node: voltage, current, temperature and perhaps the state of charge over CAN."""

from typing import Any

import can
import msgspec

from robrain.agent.plugin import Device, external, unlocked
from robrain.plugins.device.bm2.battery_frames import BatteryFrames, BatteryMap
from robrain.plugins.device.bm2.counting import counted
from robrain.plugins.device.bm2.interface import BatteryMeasurement, Bm2Interface
from robrain.protocol.can.frame_port import FramePort, frame_port
from robrain.protocol.can.frames import BadFrame

GAP_S = 2.0
"""A longer time between two frames is not counted."""


class Bm2(Device):
    """Reads the battery manager's measurements and integrates charge and energy."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """python-can's interface and channel, and the frames of the battery."""

        interface: str = "zenoh"
        channel: str = "can0"
        options: dict[str, Any] = {}
        """Other options of the interface."""
        battery: BatteryMap = BatteryMap()
        """Frames and signals of the battery manager."""

    interface = Bm2Interface
    period_s = 0.2
    parameters: Parameters

    def init(self) -> None:
        self._bus: can.BusABC | None = None
        self._port: FramePort | None = None
        self._frames = BatteryFrames(self.parameters.battery)
        self._latest: BatteryMeasurement | None = None
        self._rejected = 0

    def activate(self) -> None:
        wanted, filters = self.parameters, self._frames.filters
        self._bus = self.env.open_can(wanted.interface, wanted.channel, can_filters=filters, **wanted.options)
        self._port = frame_port(self._bus)

    def step(self) -> None:
        if self._port is None:
            return
        for frame in self._port.take_frames():
            try:
                values = self._frames.read(frame)
            except BadFrame:
                self._rejected += 1
                continue
            if values is not None:
                self._latest = counted(self._latest, frame.stamp_ns, *values, gap_s=GAP_S)

    def deactivate(self) -> None:
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = self._port = None

    @external
    @unlocked
    def latest(self) -> BatteryMeasurement | None:
        """The last measurement; null before the first."""
        return self._latest

    @external
    def rejected(self) -> int:
        """Frames that were rejected: wrong length or checksum."""
        return self._rejected
