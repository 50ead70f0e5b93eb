"""The ring of range sensors and the ring of bump contacts: how they are numbered, on both sides of the bus.

Sensors and contacts count counter-clockwise from straight ahead, in the robot's frame. Six sensors and eight contacts
are chosen; the frames of `robertino.dbc` carry up to twelve and eight.
"""

import math
from typing import Annotated, Any, Protocol

import can
import msgspec
from msgspec import Meta

from robrain.agent.errors import PluginError
from robrain.agent.event import Event
from robrain.agent.plugin import Device, external
from robrain.agent.silence import Silence
from robrain.protocol.can.frame_port import FramePort, frame_port
from robrain.protocol.can.frames import BadFrame, FrameCodec, codec
from robrain.protocol.can.payload import ERROR, ID_MASK, REMOTE, SequenceCounter
from robrain.protocol.clock import NS_PER_S, to_ns
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import Positive

RING_ANGLES_RAD = tuple(math.tau * sensor / 6 for sensor in range(6))
SENSORS_A_FRAME = 6
SENSORS_MAX = 12
NO_ECHO_M = 2.55
"""Range in a frame that means no echo."""
BUMP_SECTORS = 8
"""A contact each; the first points straight ahead, and covers 22.5° to either side."""


def bump_sector(direction_rad: float) -> int:
    """The contact that a touch from this direction of the robot's frame presses.

    >>> [bump_sector(angle) for angle in (0.0, 0.5, math.pi, -0.5)]
    [0, 1, 4, 7]
    """
    return round(direction_rad * BUMP_SECTORS / math.tau) % BUMP_SECTORS


def bump_directions_rad(contacts: int) -> list[float]:
    """Directions of the pressed contacts, in (−π, π], from the bits of a frame.

    >>> bump_directions_rad(0b100) == [math.pi / 2]
    True
    """
    return [
        math.remainder(math.tau * sector / BUMP_SECTORS, math.tau)
        for sector in range(BUMP_SECTORS)
        if contacts >> sector & 1
    ]


class RangeRing(msgspec.Struct, frozen=True):
    """One measurement of all range sensors, robot's frame.

    A range is the distance from the hull, along its sensor's direction; `range_max_m` means no echo.
    """

    stamp_ns: int
    angles_rad: tuple[float, ...]
    ranges_m: tuple[float, ...]
    range_max_m: float
    mounted_m: float
    """Distance of the sensors from the robot's centre."""


class Bump(msgspec.Struct, frozen=True):
    """A touch of the hull has begun or ended."""

    stamp_ns: int
    directions_rad: tuple[float, ...]
    """Directions of the touch, robot's frame; none without a touch."""


class RangeSensorsInterface(Protocol):
    """Ranges and bumps as they come."""

    measured: Event[RangeRing]
    bumped: Event[Bump]
    """Whenever the contacts that are pressed change."""

    def latest(self) -> RangeRing | None:
        """The last measurement; None before the first, as on a robot without the sensors."""

    def pressed_rad(self) -> tuple[float, ...]:
        """Directions of the contacts that are pressed now, robot's frame."""


POLL_S = 0.04
"""Period of the step where the bus does not signal arrivals."""
CHECK_S = 0.08
"""Period where it does, to detect a silent node."""
FRAMES_ID, FRAMES_MASK = 0x280, 0x7FC
"""The node's frames are 0x280 to 0x283."""


class RangeSensorFault(PluginError):
    """The node has fallen silent, or its bus cannot be read."""


class RangeCounters(msgspec.Struct, frozen=True):
    """Counters of the device's node."""

    believed: int
    rejected: int
    lost: int


class RangeSensorsDevice(Device):
    """Passes on each measurement of the ring and each change of the bump contacts."""

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """`interface`, `channel` and `options` as for mocdevice. No data sheet was found: the values are chosen."""

        interface: str = "zenoh"
        channel: str = "can0"
        options: dict[str, Any] = msgspec.field(default_factory=dict)
        angles_rad: Annotated[tuple[float, ...], Meta(min_length=1, max_length=SENSORS_MAX)] = RING_ANGLES_RAD
        """Directions of the sensors, robot's frame, in the order of the frames' signals."""
        range_max_m: Positive = 2.0
        mounted_m: Positive = 0.20
        """Distance of the sensors from the robot's centre."""
        silent_s: Positive = 1.0
        """Time without a frame after which the node counts as gone; it sends ten frames a second."""

    interface = RangeSensorsInterface
    period_s = POLL_S
    parameters: Parameters
    measured = Event[RangeRing]()
    bumped = Event[Bump](outside=True)
    silent = Event[str](outside=True)

    def init(self) -> None:
        self._bus: can.BusABC | None = None
        self._port: FramePort | None = None
        sensors = len(self.parameters.angles_rad)
        self._rings = {
            (frame := codec(f"RangeRing{number + 1}")).arbitration_id: (
                frame,
                first,
                min(SENSORS_A_FRAME, sensors - first),
            )
            for number, first in enumerate(range(0, sensors, SENSORS_A_FRAME))
        }
        self._last_id = max(self._rings)
        self._bumps = codec("Bumps")
        self._sequences = {identifier: SequenceCounter() for identifier in (*self._rings, self._bumps.arbitration_id)}
        self._ranges_m = [self.parameters.range_max_m] * sensors
        self._latest: RangeRing | None = None
        self._pressed_rad: tuple[float, ...] = ()
        self._believed = self._rejected = 0

    def activate(self) -> None:
        wanted = self.parameters
        self._silence = Silence(to_ns(wanted.silent_s))
        self._received_ns: int | None = None
        filters: can.typechecking.CanFilters = [{"can_id": FRAMES_ID, "can_mask": FRAMES_MASK, "extended": False}]
        self._bus = self.env.open_can(wanted.interface, wanted.channel, can_filters=filters, **wanted.options)
        self._port = frame_port(self._bus)
        self._port.on_frame = self.env.hurry
        self.period_s = CHECK_S if self._port.wakes else POLL_S

    def step(self) -> None:
        if self._port is None:
            return
        try:
            self._listen(self._port)
            self._check()
        except RangeSensorFault as fault:
            self.silent.notify(str(fault))
            raise

    def deactivate(self) -> None:
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = self._port = None

    @external
    def latest(self) -> RangeRing | None:
        """The last measurement; null before the first, as on a robot without the sensors."""
        return self._latest

    @external
    def pressed_rad(self) -> tuple[float, ...]:
        """Directions of the contacts that are pressed now, robot's frame."""
        return self._pressed_rad

    @external
    def counters(self) -> RangeCounters:
        """The node's frames: accepted, rejected (length or checksum) and lost (gaps in their counters)."""
        return RangeCounters(self._believed, self._rejected, sum(watch.lost for watch in self._sequences.values()))

    def _listen(self, port: FramePort) -> None:
        try:
            frames = port.read_frames()
        except (can.CanError, OSError) as error:
            raise RangeSensorFault(self.env.plugin, f"the CAN bus cannot be read: {error}") from error
        for frame in frames:
            if frame.identifier & (REMOTE | ERROR):
                continue
            identifier = frame.identifier & ID_MASK
            ring = self._rings.get(identifier)
            if ring is not None:
                self._read_ring(identifier, frame.data, *ring)
            elif identifier == self._bumps.arbitration_id:
                self._read_bumps(frame.data)

    def _check(self) -> None:
        if self._received_ns is None:
            return
        now_ns = self.env.clock.now_ns()
        if now_ns - self._received_ns <= self._silence.begins_ns:
            return
        silent_ns = self._silence.since(self._received_ns, now_ns)
        if silent_ns > self._silence.limit_ns:
            raise RangeSensorFault(
                self.env.plugin,
                f"the range sensors have been silent for {silent_ns / NS_PER_S:.1f} s: "
                "their node or the CAN bus is gone",
            )

    def _read_ring(self, identifier: int, data: bytes, ring: FrameCodec, first: int, count: int) -> None:
        values = self._believe(identifier, data, ring)
        if values is None:
            return
        range_max_m = self.parameters.range_max_m
        for place in range(count):
            range_m = values[place]
            self._ranges_m[first + place] = range_m if range_m < range_max_m else range_max_m
        if identifier == self._last_id:
            self._latest = RangeRing(
                self.env.clock.now_ns(),
                self.parameters.angles_rad,
                tuple(self._ranges_m),
                range_max_m,
                self.parameters.mounted_m,
            )
            self.measured.notify(self._latest)

    def _read_bumps(self, data: bytes) -> None:
        values = self._believe(self._bumps.arbitration_id, data, self._bumps)
        if values is None:
            return
        pressed_rad = tuple(bump_directions_rad(int(values[0])))
        if pressed_rad != self._pressed_rad:
            self._pressed_rad = pressed_rad
            self.bumped.notify(Bump(self.env.clock.now_ns(), pressed_rad))

    def _believe(self, identifier: int, data: bytes, frame: FrameCodec) -> tuple[float, ...] | None:
        try:
            values = frame.decode(data)
        except BadFrame:
            self._rejected += 1
            return None
        self._believed += 1
        self._received_ns = self.env.clock.now_ns()
        self._sequences[identifier].record(int(values[-1]))
        return values
