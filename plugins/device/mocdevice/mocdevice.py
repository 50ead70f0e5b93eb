"""Motor controller on CAN: by its defaults that of a base with three omni wheels in the style of the Robertino.

Another base is a matter of parameters: its kinematics (`base`), and the frames of its DBC file (`frames`).
"""

import logging
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import can
import msgspec

from robrain.algorithms.navigation.wheel_bases import Ackermann
from robrain.plugins.device.mocdevice.frame_clock import StampedAt
from robrain.plugins.device.mocdevice.frame_map import (
    FrameMap,
    FrameSignals,
    OtherPart,
    SignalFrame,
    each_of,
    read_dbc,
    signal_frames,
)
from robrain.plugins.device.mocdevice.interface import BusFault, ControllerStatus, Counters
from robrain.plugins.device.mocdevice.wheel_device import Counting, OpenLink, WheelDevice, WheelLink, WheelReport
from robrain.protocol.can.bus_state import BusState, state_in
from robrain.protocol.can.frame_port import Frame, frame_port
from robrain.protocol.can.frames import BadFrame, FrameCodec, known_identifiers
from robrain.protocol.can.payload import ERROR, EXTENDED, ID_MASK, MODULUS, SequenceCounter
from robrain.protocol.clock import to_ns
from robrain.protocol.model.geometry import Twist2D

STATUS_FIELDS = ControllerStatus.__struct_fields__
SPEED_TICKS_PER_RAD = 100_000
"""Speeds are added up in ticks of this size."""
SPEED_MODULUS = 1 << 48

Codec = FrameCodec | SignalFrame


class WheelFrame(NamedTuple):
    """A frame with the signals of wheels."""

    codec: Codec
    factors: tuple[float, ...]
    """Commands: a signal's value for a base's value of 1 in SI units; encoders: the inverse, or the sign of a count."""


class WheelFrames:
    """The codecs of a frame map, for one base.

    Args:
        wanted: the map.
        commands: number of values that the base is commanded by.
        wheels: number of wheels that count.
        wheel_radius_m: for units along the tread.

    Raises:
        ValueError: naming the key: the DBC file has no such frame or signal, or their number does not fit the base.

    """

    def __init__(self, wanted: FrameMap, commands: int, wheels: int, wheel_radius_m: float) -> None:
        dbc = read_dbc(wanted.dbc)
        is_speed = wanted.measure == "speed"

        def codecs(what: str, frame: str, signals: tuple[str, ...]) -> list[Codec]:
            try:
                return signal_frames(dbc, frame, signals, wanted.counter, wanted.checksum)
            except ValueError as error:
                raise ValueError(f"frames.{what}: {error}") from error

        def codec(what: str, frame: str, signals: tuple[str, ...]) -> Codec:
            found = codecs(what, frame, signals)
            if len(found) > 1:
                raise ValueError(f"frames.{what}: no frame {frame} has all of {', '.join(signals)}: it is multiplexed")
            return found[0]

        def wheels_of(what: str, frames: Sequence[FrameSignals], number: int, exponent: int) -> list[WheelFrame]:
            there = sum(len(one.signals) for one in frames)
            if there != number:
                raise ValueError(f"frames.{what}: expected {number} signals for this base, got {there}")
            parts = []
            for one in frames:
                factors = [
                    sign * unit.per_si(wheel_radius_m) ** exponent
                    for unit, sign in zip(
                        each_of(one.units, len(one.signals)), each_of(one.signs, len(one.signals)), strict=True
                    )
                ]
                for part in codecs(what, one.frame, one.signals):
                    parts.append(WheelFrame(part, tuple(factors[: len(part.signals)])))
                    del factors[: len(part.signals)]
            return parts

        self.commands = wheels_of("commands", wanted.commands, commands, 1)
        self.encoders = wheels_of("encoders", wanted.encoders, wheels, -1 if is_speed else 0)
        self.modulus = SPEED_MODULUS if is_speed else _modulus(self.encoders)
        """Counts wrap at this."""
        self.stop, self.stop_values = None, ()
        if wanted.stop.frame:
            names = tuple(wanted.stop.values)
            self.stop, self.stop_values = codec("stop", wanted.stop.frame, names), tuple(wanted.stop.values.values())
            _check_holds("stop.values", self.stop, self.stop_values)
        self.status, self.status_fields, self.failed = None, (), frozenset(())
        if wanted.status.frame:
            names = _status_signals(dbc, wanted.status.frame, wanted.status.state)
            self.status = codec("status", wanted.status.frame, names)
            self.status_fields = tuple("state" if name == wanted.status.state else name for name in names)
            self.failed = frozenset(wanted.status.failed)
        self.known = known_identifiers() | frozenset(
            message.frame_id | (EXTENDED if message.is_extended_frame else 0) for message in dbc.messages
        )
        """Identifiers of the frames in the DBC file, and of robrain's other devices on the bus."""
        self.has_counter, self.is_speed, self.period_s = bool(wanted.counter), is_speed, wanted.encoder_period_s

    stop: Codec | None
    stop_values: tuple[float, ...]
    status: Codec | None
    status_fields: tuple[str, ...]
    """Fields of ControllerStatus, in the order of the codec's values."""
    failed: frozenset[int]

    def check_limits(self, limits: Sequence[float]) -> None:
        """Raise ValueError, naming the keys, if the frames cannot hold commands of these sizes (SI units)."""
        begin = 0
        for wheels in self.commands:
            end = begin + len(wheels.factors)
            most = [factor * limit for factor, limit in zip(wheels.factors, limits[begin:end], strict=True)]
            for sign in (1.0, -1.0):
                _check_holds("commands, at wheel_speed_max_rad_s", wheels.codec, [sign * value for value in most])
            begin = end


def _check_holds(what: str, codec: Codec, values: Sequence[float]) -> None:
    try:
        codec.encode(0, *values)
    except (OverflowError, ValueError) as error:
        raise ValueError(f"frames.{what}: {error}") from error


def _modulus(encoders: Sequence[WheelFrame]) -> int:
    lengths = {bits for one in encoders for bits in one.codec.bits[: len(one.factors)]}
    if len(lengths) > 1:
        raise ValueError(f"frames.encoders: expected counts of one length, got {sorted(lengths)} bits")
    return 1 << lengths.pop()


def _status_signals(dbc: Any, frame: str, state: str) -> tuple[str, ...]:
    """The state, then the other signals whose names are those of ControllerStatus."""
    found = next((message for message in dbc.messages if message.name == frame), None)
    ids = {signal.name: signal.multiplexer_ids for signal in found.signals} if found is not None else {}
    together = [name for name in ids if ids[name] in (None, ids.get(state))]
    return (state, *(name for name in together if name in STATUS_FIELDS and name != state))


ROUND_SHARE = 0.75
"""Frames of one round come within this share of their period."""
ECHOES = 64
"""Own frames that are remembered: some interfaces give them back."""


class CanLink(WheelLink):
    """See WheelLink.

    Args:
        bus: closed with the link.
        frames: the frames on it.
        plugin: the device, named in faults.
        warn: called for a bus that is error passive.

    """

    def __init__(self, bus: can.BusABC, frames: WheelFrames, plugin: str, warn: Callable[[str], None]) -> None:
        self._bus, self._frames, self._plugin, self._warn = bus, frames, plugin, warn
        self._port = frame_port(bus)
        self.pending = self._port.pending
        self._counter = 0
        self._sent: deque[bytes] = deque(maxlen=ECHOES)
        stop = [frames.stop] if frames.stop is not None else []
        self._own = {codec.arbitration_id for codec in (*(one.codec for one in frames.commands), *stop)}
        self._by_id: dict[int, list[int]] = {}
        for number, one in enumerate(frames.encoders):  # a multiplexed frame has several parts
            self._by_id.setdefault(one.codec.arbitration_id, []).append(number)
        first = frames.encoders[0]
        is_plain = frames.has_counter and not frames.is_speed and set(first.factors) == {1.0}
        self._plain_id = first.codec.arbitration_id if is_plain and len(frames.encoders) == 1 else -1
        """Of counts that need no conversion."""
        self._status_id = frames.status.arbitration_id if frames.status is not None else -1
        self._sequences = {identifier: SequenceCounter() for identifier in self._by_id}
        self._parts: list[tuple[float, ...] | None] = [None] * len(frames.encoders)
        """Values of each encoder frame since the last complete report."""
        self._added_up = [0.0] * sum(len(one.factors) for one in frames.encoders)
        """Ticks of each wheel, where speeds are measured."""
        self._round_ns = 0
        """When the first frame of the present round was measured."""
        self._round_most_ns = to_ns(ROUND_SHARE * frames.period_s)
        self._missing = 0
        """Rounds of several encoder frames that were not complete since the last report."""
        self._last_ns: int | None = None
        self._rejected = self._foreign = self._errors = 0
        self._refused = self._others = 0
        """Frames since the last report: refused ones, and all that are not this robot's own."""
        self._refusal = ""

    def command(self, values: Sequence[float]) -> None:
        """As WheelLink."""
        begin = 0
        for wheels in self._frames.commands:
            end = begin + len(wheels.factors)
            part = [factor * value for factor, value in zip(wheels.factors, values[begin:end], strict=True)]
            self._send(wheels.codec, part)
            begin = end

    def stop(self) -> None:
        """As WheelLink."""
        if self._frames.stop is not None:
            self._send(self._frames.stop, self._frames.stop_values)
        else:
            self.command([0.0] * sum(len(one.factors) for one in self._frames.commands))

    def receive(self) -> list[WheelReport]:
        """As WheelLink."""
        reports: list[WheelReport] = []
        if self.broken is not None:
            return reports
        try:
            frames = self._port.read_frames()
        except (can.CanError, OSError) as error:
            self.broken = BusFault(self._plugin, f"the CAN bus cannot be read: {error}")
            return reports
        plain = self._frames.encoders[0].codec
        sequence = self._sequences[plain.arbitration_id]
        for frame in frames:
            identifier = frame.identifier
            if identifier == self._plain_id:  # the Robertino's: nothing to convert
                try:
                    *counts, counter = map(int, plain.decode(frame.data))
                except BadFrame as error:
                    self._refuse(error)
                    continue
                if counter == sequence.expected:
                    sequence.expected = (counter + 1) % MODULUS
                    missing = 0
                else:
                    missing = sequence.record(counter)
                reports.append(WheelReport(tuple(counts), frame.stamp_ns, counter, missing))
            elif identifier in self._by_id:
                if (report := self._read_encoders(frame)) is not None:
                    reports.append(report)
            elif identifier & ERROR:
                self._read_error(frame)
            elif identifier == self._status_id:
                self._read_status(frame.data)
            elif identifier in self._own:
                self._foreign += frame.data not in self._sent
            elif identifier not in self._frames.known:
                self._foreign += 1
        if reports:
            self._refused = self._others = 0
        elif frames:
            self._others += sum(not frame.identifier & ERROR and frame.identifier not in self._own for frame in frames)
        return reports

    @property
    def refusal(self) -> str:
        """As WheelLink."""
        if self._refused:
            return f"{self._refused} frames were refused: {self._refusal}"
        names = ", ".join(dict.fromkeys(one.codec.name for one in self._frames.encoders))
        return f"{self._others} frames came, but not all counts of {names}" if self._others else ""

    def counters(self, believed: int, rejected: int) -> Counters:
        """As WheelLink."""
        lost = sum(sequence.lost for sequence in self._sequences.values())
        return Counters(believed, rejected + self._rejected, self._foreign, lost, self._errors)

    def close(self) -> None:
        """As WheelLink."""
        self._bus.shutdown()

    def _send(self, codec: Codec, values: Sequence[float]) -> None:
        self._counter = (self._counter + 1) & 0xFF
        data = codec.encode(self._counter, *values)
        self._sent.append(data)
        try:
            self._port.send_data(codec.arbitration_id, data)
        except (can.CanError, OSError) as error:
            # The caller is not at fault, and may be a halt: the device's own step reports the error.
            self.broken = BusFault(self._plugin, f"the CAN bus takes no frames: {error}")

    def _refuse(self, error: BadFrame) -> None:
        self._rejected += 1
        self._refused += 1
        self._refusal = str(error)

    def _read_encoders(self, frame: Frame) -> WheelReport | None:
        """The counts of all wheels, if this frame completes them."""
        for number in self._by_id[frame.identifier]:
            try:
                values = self._frames.encoders[number].codec.decode(frame.data)
            except OtherPart:
                continue
            except BadFrame as error:
                self._refuse(error)
                return None
            return self._record_part(number, values, frame)
        return None  # of no wheel

    def _record_part(self, number: int, values: tuple[float, ...], frame: Frame) -> WheelReport | None:
        counter, wheels = None, self._frames.encoders[number]
        if self._frames.has_counter:
            counter = int(values[-1])
            lost = self._sequences[frame.identifier].record(counter)
            self._missing += lost if 0 in self._by_id[frame.identifier] else 0
        if frame.stamp_ns - self._round_ns > self._round_most_ns:  # the remaining frames are of an incomplete round
            self._missing += self._parts[0] is not None
            self._parts = [None] * len(self._parts)
        if not any(self._parts):
            self._round_ns = frame.stamp_ns
        self._parts[number] = tuple([factor * value for factor, value in zip(wheels.factors, values, strict=False)])
        if None in self._parts:
            return None
        parts, self._parts = self._parts, [None] * len(self._parts)
        missing, self._missing = self._missing, 0
        whole = [value for part in parts if part is not None for value in part]
        if self._frames.is_speed:
            return WheelReport(self._add_up(whole, frame.stamp_ns), frame.stamp_ns, counter, missing)
        return WheelReport(tuple(map(int, whole)), frame.stamp_ns, counter, missing)

    def _add_up(self, speeds: Sequence[float], stamp_ns: int) -> tuple[int, ...]:
        """Ticks after the time since the frame before, at these speeds."""
        period_s = self._frames.period_s
        since_s = (stamp_ns - self._last_ns) / 1e9 if self._last_ns is not None else period_s
        self._last_ns = stamp_ns
        elapsed_s = since_s if 0.0 < since_s < 10 * period_s else period_s
        for wheel, speed in enumerate(speeds):
            self._added_up[wheel] += speed * elapsed_s * SPEED_TICKS_PER_RAD
        return tuple([round(ticks) % SPEED_MODULUS for ticks in self._added_up])

    def _read_error(self, frame: Frame) -> None:
        self._errors += 1
        state = state_in(frame.identifier & ID_MASK, frame.data)
        if state is BusState.OFF:
            self.broken = BusFault(self._plugin, "the computer's CAN controller is bus off")
        if state is BusState.PASSIVE:
            self._warn("the CAN bus is error passive: does another node acknowledge frames?")

    def _read_status(self, data: bytes) -> None:
        codec = self._frames.status
        if codec is None:
            return
        try:
            values = codec.decode(data)
        except OtherPart:
            return
        except BadFrame as error:
            self._refuse(error)
            return
        reported = dict(zip(self._frames.status_fields, map(int, values), strict=False))
        self.status = ControllerStatus(**reported)
        self.statuses += 1
        self.has_failed = self.status.state in self._frames.failed


logger = logging.getLogger(__name__)

STAMPS_SENDING = "zenoh"
"""Name of the interface whose frames carry stamps of the sender."""


class MocDevice(WheelDevice):
    """Turns velocities into wheel commands and encoder counts into odometry."""

    class Parameters(WheelDevice.Parameters, msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """`interface` and `channel` are python-can's; the default wheel sizes are chosen, no data sheet was found."""

        interface: str = "zenoh"
        channel: str = "can0"
        options: dict[str, Any] = {}
        """Other options of python-can's interface, such as `bitrate` or `port`."""
        frames: FrameMap = FrameMap()
        """Frames and signals of the controller."""
        stamped_at: StampedAt | None = None
        """Meaning of the interface's time stamps; None is `sending` for `zenoh` and `arrival` for all others."""

    parameters: Parameters

    def open_link(self) -> OpenLink:
        wanted, base = self.parameters, self.parameters.base
        commands = len(base.commands(Twist2D(), wanted.wheel_speed_max_rad_s))
        frames = WheelFrames(wanted.frames, commands, base.wheels, base.wheel_radius_m)
        fastest = wanted.wheel_speed_max_rad_s
        frames.check_limits((fastest, base.steering_max_rad) if isinstance(base, Ackermann) else (fastest,) * commands)
        robot = self.env.robot
        bus = self.env.open_can(wanted.interface, wanted.channel, **wanted.options)
        link = CanLink(bus, frames, self.env.plugin, lambda what: logger.warning("%s: %s", robot, what))
        stamped_at = wanted.stamped_at
        if stamped_at is None:
            stamped_at = StampedAt.SENDING if wanted.interface == STAMPS_SENDING else StampedAt.ARRIVAL
        rad_per_tick = 1.0 / SPEED_TICKS_PER_RAD if frames.is_speed else base.rad_per_tick
        return OpenLink(
            link,
            f"the CAN bus {wanted.interface}:{wanted.channel} is cut or its controller gone",
            Counting(frames.modulus, rad_per_tick),
            frames.period_s,
            stamped_at,
        )
