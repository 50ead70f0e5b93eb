"""Battery manager node: voltage, current, temperature and perhaps the state of charge over CAN."""

import math
from typing import Annotated, Any, Literal

import can
import msgspec
from msgspec import Meta

from robrain.agent.plugin import external
from robrain.plugins.device.bm2.interface import BadReading, BatteryDevice, Reading, plausible
from robrain.plugins.device.mocdevice.frame_map import (
    Checksum,
    OtherPart,
    Sign,
    SignalFrame,
    SignalName,
    read_dbc,
    signal_frames,
)
from robrain.protocol.can.frame_port import Frame, FramePort, frame_port
from robrain.protocol.can.frames import BadFrame, FrameCodec
from robrain.protocol.can.payload import EXTENDED, ID_MASK
from robrain.protocol.clock import to_ns
from robrain.protocol.model.checked import Checked

SIGNALS_MAX = 8
RECENT_NS = to_ns(5.0)
"""Values that another frame reported longer ago than this are not combined with a measurement."""


PackValue = Literal[
    "voltage V", "voltage mV", "current A", "current mA", "temperature °C", "temperature K", "soc", "soc %"
]
"""Meaning of a signal, and its unit; `soc` is 0 to 1. Currents are positive while discharging; see `current_sign`."""
Quantity = tuple[str, float, float]
QUANTITIES: dict[PackValue, Quantity] = {
    "voltage V": ("voltage", 1.0, 0.0),
    "voltage mV": ("voltage", 1e-3, 0.0),
    "current A": ("current", 1.0, 0.0),
    "current mA": ("current", 1e-3, 0.0),
    "temperature °C": ("temperature", 1.0, 0.0),
    "temperature K": ("temperature", 1.0, -273.15),
    "soc": ("soc", 1.0, 0.0),
    "soc %": ("soc", 1e-2, 0.0),
}
"""Its quantity, and factor and offset to V, A, °C, or a share from 0 to 1."""


class BatteryFrame(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One frame, with the signals in it that are of use, by name."""

    frame: SignalName
    signals: Annotated[dict[SignalName, PackValue], Meta(min_length=1, max_length=SIGNALS_MAX)]


class BatteryMap(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Parameters, including those that the frames have in common.

    Raises ValueError where a quantity is reported twice, or no voltage.
    """

    dbc: Annotated[str, Meta(min_length=1, max_length=4096)] = "robertino"
    """Path of the DBC file; or `robertino` or `two_wheels`, which come with robrain."""
    frames: Annotated[tuple[BatteryFrame, ...], Meta(min_length=1, max_length=SIGNALS_MAX)] = (
        BatteryFrame(
            frame="BatteryStatus",
            signals={
                "voltage_v": "voltage V",
                "current_a": "current A",
                "temperature_c": "temperature °C",
            },
        ),
    )
    """Each frame with the voltage is a measurement; values of the other frames belong to the next one."""
    current_sign: Sign = 1
    """-1 if the battery reports a current that is positive while charging."""
    current_a: float = 1.0
    """Taken as drawn if no signal reports the current."""
    soc_sd: Annotated[float, Meta(gt=0, lt=1.0)] = 0.03
    """Standard deviation of the state of charge that the battery reports."""
    counter: str = "counter"
    """Name of the signal that counts a sender's frames, 8 bits; empty if there is none."""
    checksum: Checksum = Checksum.CRC8_J1850_ID

    def __post_init__(self) -> None:
        super().__post_init__()
        fields = [QUANTITIES[meaning][0] for one in self.frames for meaning in one.signals.values()]
        if len(fields) != len(set(fields)) or "voltage" not in fields:
            raise ValueError(f"frames: expected a voltage and each quantity once, got {', '.join(fields)}")


class Bm2(BatteryDevice):
    """Reads the battery manager's measurements and integrates charge and energy."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """python-can's interface and channel, and the frames of the battery."""

        interface: str = "zenoh"
        channel: str = "can0"
        options: dict[str, Any] = {}
        """Other options of the interface."""
        battery: BatteryMap = BatteryMap()
        """Frames and signals of the battery manager."""

    parameters: Parameters

    def init(self) -> None:
        self._bus: can.BusABC | None = None
        self._port: FramePort | None = None
        self._rejected = 0
        wanted = self.parameters.battery
        dbc, self._codecs = read_dbc(wanted.dbc), dict[int, list[tuple[FrameCodec | SignalFrame, list[Quantity]]]]()
        """The parts of each frame, several if it is multiplexed, with the quantities of their signals."""
        for one in wanted.frames:
            try:
                parts = signal_frames(dbc, one.frame, tuple(one.signals), wanted.counter, wanted.checksum)
            except ValueError as error:
                raise ValueError(f"battery.frames: {error}") from error
            if parts[0].arbitration_id in self._codecs:
                raise ValueError(f"battery.frames: expected each frame once, got {one.frame} again")
            self._codecs[parts[0].arbitration_id] = [
                (codec, [QUANTITIES[one.signals[name]] for name in codec.signals]) for codec in parts
            ]
        fields = {QUANTITIES[meaning][0] for one in wanted.frames for meaning in one.signals.values()}
        self._has_current, self._has_soc = "current" in fields, "soc" in fields
        self._reported: dict[str, tuple[float, int]] = {}
        """Value and stamp of each quantity."""

    def activate(self) -> None:
        wanted = self.parameters
        filters: can.typechecking.CanFilters = [
            {"can_id": identifier & ID_MASK, "can_mask": ID_MASK, "extended": True}
            if identifier & EXTENDED
            else {"can_id": identifier, "can_mask": 0x7FF, "extended": False}
            for identifier in self._codecs
        ]
        self._bus = self.env.open_can(wanted.interface, wanted.channel, can_filters=filters, **wanted.options)
        self._port = frame_port(self._bus)

    def step(self) -> None:
        if self._port is None:
            return
        for frame in self._port.read_frames():
            try:
                reading = self._read(frame)
            except BadFrame:
                self._rejected += 1
                continue
            if reading is not None:
                self.count(reading, frame.stamp_ns)

    def deactivate(self) -> None:
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = self._port = None

    @external
    def rejected(self) -> int:
        """Frames that were rejected: wrong length or checksum."""
        return self._rejected

    def _read(self, frame: Frame) -> Reading | None:
        """The measurement that a frame completes, if it does (BadFrame: wrong length or checksum, or no number)."""
        for codec, quantities in self._codecs.get(frame.identifier, ()):
            try:
                values = codec.decode(frame.data)
            except OtherPart:
                continue
            if not all(map(math.isfinite, values)):
                raise BadFrame(f"{codec.name}: expected finite values, got {values}")
            has_voltage = False
            for (field, factor, offset), value in zip(quantities, values, strict=False):
                self._reported[field] = factor * value + offset, frame.stamp_ns
                has_voltage |= field == "voltage"
            return self._measurement(codec.name, frame.stamp_ns) if has_voltage else None
        return None

    def _measurement(self, frame: str, stamp_ns: int) -> Reading | None:
        current_a = self._recent("current", stamp_ns)
        if self._has_current and current_a is None:
            return None  # the frame with the current has not come, or has stopped
        wanted = self.parameters.battery
        try:
            return plausible(
                self._reported["voltage"][0],
                None if current_a is None else wanted.current_sign * current_a,
                self._recent("temperature", stamp_ns),
                self._recent("soc", stamp_ns),
                assumed_a=None if self._has_current else wanted.current_a,
                soc_sd=wanted.soc_sd if self._has_soc or not self._has_current else None,
            )
        except BadReading as error:
            raise BadFrame(f"{frame}: {error}") from error

    def _recent(self, field: str, stamp_ns: int) -> float | None:
        value, reported_ns = self._reported.get(field, (None, 0))
        return value if abs(stamp_ns - reported_ns) <= RECENT_NS else None
