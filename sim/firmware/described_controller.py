"""The motor controller of a described base: other wheels and other frames than the Robertino's.

The simulated hull moves by three omni wheels. This controller turns them so that the hull moves as the described wheels
would move it. It counts the turns of the described wheels.
"""

import re
from collections.abc import Callable, Sequence, Sized

import can

from robrain.algorithms.navigation.wheel_bases import Ackermann, Differential, Mecanum, Omni, OmniBase
from robrain.plugins.device.mocdevice.frame_map import (
    Checksum,
    FrameMap,
    FrameSignals,
    SignalFrame,
    SignalUnit,
    StatusFrame,
    StopFrame,
    read_dbc,
)
from robrain.protocol.can.frame_port import frame_port
from robrain.protocol.can.frames import BadFrame
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.model.geometry import Twist2D
from robrain.sim.firmware.motor_controller import MotorController, MotorState

Chassis = Differential | Omni | Mecanum | Ackermann
HALF_TURN, MODULUS = 1 << 31, 1 << 32


def _map(dbc: str, command: FrameSignals, *encoders: FrameSignals) -> FrameMap:
    return FrameMap(
        dbc=dbc,
        commands=(command,),
        encoders=encoders,
        stop=StopFrame(frame=""),
        status=StatusFrame(frame="DriveState"),
        counter="",
        checksum=Checksum.NONE,
    )


TWO_WHEELS = _map(
    "two_wheels",
    FrameSignals(frame="DriveCommand", signals=("left_rpm", "right_rpm"), units=(SignalUnit.RPM,)),
    FrameSignals(frame="LeftEncoder", signals=("left_counts",)),
    FrameSignals(frame="RightEncoder", signals=("right_counts",)),
)
FOUR_WHEELS = _map(
    "four_wheels",
    FrameSignals(
        frame="DriveCommand",
        signals=("wheel_1_rpm", "wheel_2_rpm", "wheel_3_rpm", "wheel_4_rpm"),
        units=(SignalUnit.RPM,),
    ),
    FrameSignals(frame="EncodersOneTwo", signals=("wheel_1_counts", "wheel_2_counts")),
    FrameSignals(frame="EncodersThreeFour", signals=("wheel_3_counts", "wheel_4_counts")),
)
CAR = _map(
    "car",
    FrameSignals(frame="DriveCommand", signals=("speed_rpm", "steering_deg"), units=(SignalUnit.RPM, SignalUnit.DEG)),
    FrameSignals(frame="RearEncoders", signals=("left_counts", "right_counts")),
)


def frames_of(chassis: Chassis) -> FrameMap:
    """Description of this controller's frames, for the robot.

    Raises:
        ValueError: no simulated controller turns such wheels.

    """
    if isinstance(chassis, Ackermann):
        return CAR
    if isinstance(chassis, Differential) and chassis.wheels == 2:
        return TWO_WHEELS
    if not isinstance(chassis, Differential) and chassis.wheels == 4:
        return FOUR_WHEELS
    expected = "four wheel_angles_deg" if isinstance(chassis, Omni) else "wheels_per_side = 1"
    raise ValueError(f"chassis: expected {expected} in the simulator, got {chassis.wheels} wheels")


def obeyed(chassis: Chassis) -> list[int]:
    """Identifiers of the frames that the controller receives."""
    frames = frames_of(chassis)
    return [read_dbc(frames.dbc).get_message_by_name(one.frame).frame_id for one in frames.commands]


class DescribedController(MotorController):
    """A motor controller of a base that is described by its wheels; the body it moves has others.

    In each tick `roll` updates the wheels from the body's motion; `send_counts` sends the encoder counts that are due.

    Args:
        bus: the robot's bus.
        base: the described wheels.
        hull: the wheels by which the simulated body moves.
        tick_s: length of a tick.
        transmit_errors: of the node's CAN controller.

    """

    def __init__(
        self, bus: can.BusABC, base: Chassis, hull: OmniBase, tick_s: float, transmit_errors: Callable[[], int]
    ) -> None:
        super().__init__(bus, hull, tick_s, transmit_errors)
        self._base, self._hull = base, hull
        self._turns_rad = [0.0] * base.wheels

    def roll(self, forward_m: float, left_m: float, turned_rad: float) -> None:
        """Follow the body's motion of a tick."""
        for wheel, turn_rad in enumerate(self._base.wheel_speeds_rad_s(Twist2D(forward_m, left_m, turned_rad))):
            self._turns_rad[wheel] += turn_rad

    def send_counts(self) -> None:
        """Send the counts of all wheels."""

    @property
    def _counts(self) -> list[int]:
        return [int(turn_rad // self._base.rad_per_tick) for turn_rad in self._turns_rad]

    def _turn(self, commands: Sequence[float]) -> None:
        """Obey the base's commands, as of `WheelBase.commands`."""
        self._wanted_rad_s = self._hull.wheel_speeds_rad_s(self._base.commanded(commands))
        self.due_tick = self._received_tick + self._watchdog_ticks
        self.state = MotorState.RUNNING


class FrameController(DescribedController):
    """Takes commands and sends counts in the frames of a DBC file; arguments as of `DescribedController`."""

    def __init__(
        self, bus: can.BusABC, base: Chassis, hull: OmniBase, tick_s: float, transmit_errors: Callable[[], int]
    ) -> None:
        super().__init__(bus, base, hull, tick_s, transmit_errors)
        self._described = frame_port(bus)
        frames = frames_of(base)
        dbc = read_dbc(frames.dbc)

        def codec_of(one: FrameSignals) -> SignalFrame:
            return SignalFrame(dbc.get_message_by_name(one.frame), one.signals, "", Checksum.NONE)

        (command,) = frames.commands
        self._wanted = codec_of(command)
        units = command.units * (len(command.signals) // len(command.units))
        self._per_si = tuple(unit.per_si(base.wheel_radius_m) for unit in units)
        self._count_frames = tuple(codec_of(one) for one in frames.encoders)
        self._state_frame = codec_of(FrameSignals(frame=frames.status.frame, signals=("state", "fault")))

    def _read_commands(self) -> None:
        for identifier, data, _ in self._described.read_frames():
            if identifier != self._wanted.arbitration_id:
                continue
            try:
                values = self._wanted.decode(data)
            except BadFrame:
                self.rejected_frames += 1
                continue
            if not any(values) and self.state is MotorState.ERROR and not self.has_failed:
                self._stop_wheels(MotorState.WATCHDOG)  # standing still acknowledges the failure
            elif self.state is not MotorState.ERROR:
                self._turn([value / per_si for value, per_si in zip(values, self._per_si, strict=True)])

    def send_counts(self) -> None:
        """Send the counts of all wheels."""
        counts = self._counts
        for codec in self._count_frames:
            own = [(counts.pop(0) + HALF_TURN) % MODULUS - HALF_TURN for _ in codec.bits]
            self._described.send_data(codec.arbitration_id, codec.encode(0, *own))

    def send_status(self) -> None:
        """As MotorController."""
        self.has_news = False
        data = self._state_frame.encode(0, self.state, int(self.has_failed))
        self._described.send_data(self._state_frame.arbitration_id, data)


BASE_LINE = "base"
"""Name of the line."""
CYCLES_PER_S = 30.0
LINE_BYTES_MAX = 64
"""Length of the controller's buffer; a longer line is none."""
COMMAND = re.compile(rb"m (-?\d{1,6}) (-?\d{1,6})")
OBEYED, UNKNOWN = b"OK\r\n", b"Invalid Command\r\n"


class SerialPort(Sized):
    """The controller's end of the line: arrived frames, and frames to send.

    Args:
        inbox: of the bytes that the robot sends.
        put: sends bytes to the robot.

    """

    def __init__(self, inbox: Inbox, put: Callable[[bytes], None]) -> None:
        self.put = put
        self._inbox = inbox

    def __len__(self) -> int:
        return int(self._inbox.has_some)

    def read(self) -> bytes:
        """Frames that have arrived since the last call."""
        return b"".join(data for _, _, data in self._inbox.drain_raw())


class LineController(DescribedController):
    """See DescribedController; a base of two wheels.

    Args:
        port: its serial line.
        bus: of the robot's other nodes.
        base: the wheels.
        hull: the wheels by which the simulated body moves.
        tick_s: length of a tick.

    """

    def __init__(self, port: SerialPort, bus: can.BusABC, base: Differential, hull: OmniBase, tick_s: float) -> None:
        super().__init__(bus, base, hull, tick_s, lambda: 0)
        self._line = port
        self._rad_s = CYCLES_PER_S * base.rad_per_tick
        """Speed of a wheel that turns by a count in a cycle."""
        self._left = b""

    def _read_commands(self) -> None:
        if not self.has_failed and self.state is MotorState.ERROR:
            self._stop_wheels(MotorState.WATCHDOG)
        *lines, self._left = (self._left + self._line.read()).split(b"\r")
        for line in lines:
            if answer := self._answer(line.strip()) if len(line) <= LINE_BYTES_MAX else UNKNOWN:
                self._line.put(answer)
        if len(self._left) > LINE_BYTES_MAX:
            self._left = b""
            self.rejected_frames += 1

    def forget(self) -> None:
        """Drop all frames that have arrived."""
        self._line.read()
        self._left = b""

    def send_status(self) -> None:
        """It has no status."""
        self.has_news = False

    def _answer(self, line: bytes) -> bytes:
        if not line:
            return b""
        if line == b"e":
            return b"%d %d\r\n" % tuple(self._counts)
        if line == b"r":
            self._turns_rad = [0.0] * self._base.wheels
            return OBEYED
        if (found := COMMAND.fullmatch(line)) is None:
            self.rejected_frames += 1
            return UNKNOWN
        counts = [int(group) for group in found.groups()]
        if not any(counts):
            self._stop_wheels(MotorState.WATCHDOG)
        elif not self.has_failed:
            self._turn([count * self._rad_s for count in counts])
        return OBEYED
