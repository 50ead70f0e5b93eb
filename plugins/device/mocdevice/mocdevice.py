"""Motor controller of a base with three omni wheels: commands and encoder odometry over CAN.

What goes wrong on the bus is a fault of this device: a controller that falls silent, a bus that is off or cannot be
read, a power stage that has failed. The fault is told to the team, whoever requires the device is set aside, and the
manifest's restart policy opens the bus again until it answers. The odometry goes on where it was.
"""

import logging
import math
from collections import deque
from collections.abc import Sized
from typing import Any

import can
import msgspec

from robrain.agent.event import Event
from robrain.agent.plugin import Device, external
from robrain.agent.silence import Silence
from robrain.plugins.device.mocdevice.errors import BusFault, MotionFault, MotorFault
from robrain.plugins.device.mocdevice.frame_clock import FrameClock, StampedAt
from robrain.plugins.device.mocdevice.interface import ControllerStatus, Counters, MocDeviceInterface
from robrain.plugins.device.mocdevice.odometry import WheelOdometry
from robrain.protocol.can.bus_state import BusState, state_in
from robrain.protocol.can.frame_port import Frame, FramePort, frame_port
from robrain.protocol.can.frames import BadFrame, FrameCodec, codec, known_identifiers
from robrain.protocol.can.payload import ERROR, ID_MASK
from robrain.protocol.can.sequence import SequenceWatch
from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.protocol.model.navigation.omni_drive import OmniBase
from robrain.protocol.model.ranges import check_positive
from robrain.protocol.wire.clock import NS_PER_S, to_ns

logger = logging.getLogger(__name__)

WHEEL_SPEED_MAX_RAD_S = 32.0
"""The most that a WheelCommand frame can say."""
MOTOR_ERROR = 3
"""MotorStatus' state for a power stage that has failed."""
ACKNOWLEDGE_NS = to_ns(0.1)
"""A status that left the controller before it heard an acknowledgement is not held against it."""
STAMPS_SENDING = "zenoh"
"""Name of the interface whose frames carry stamps of the sender."""
ECHOES = 64
"""Own frames that are remembered: some interfaces give them back."""


class Condition(msgspec.Struct, frozen=True):
    """Whether the robot can be driven, when that changes."""

    ok: bool
    why: str = ""


class MocDevice(Device):
    """Turns velocities into wheel commands and encoder counts into odometry."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """`interface` and `channel` are python-can's; wheel sizes are chosen, no data sheet was found."""

        interface: str = "zenoh"
        channel: str = "can0"
        options: dict[str, Any] = {}
        """Other options of python-can's interface, such as `bitrate` or `port`."""
        radius_m: float = 0.20
        base: OmniBase = OmniBase()
        silent_s: float = 0.4
        """Time without an encoder frame after which the bus counts as cut; frames come every 20 ms."""
        stamped_at: StampedAt | None = None
        """Meaning of the interface's time stamps; None is `sending` for `zenoh` and `arrival` for all others."""

        def __post_init__(self) -> None:
            check_positive(self, "radius_m", "silent_s")

    interface = MocDeviceInterface
    period_s = 0.06  # and whenever somebody asks for the odometry
    parameters: Parameters
    condition = Event[Condition](outside=True)

    def init(self) -> None:
        self._bus: can.BusABC | None = None
        self._port: FramePort | None = None
        self._pending: Sized = ()
        """Empty if there is nothing to catch up with."""
        self._command, self._stop = codec("WheelCommand"), codec("Stop")
        self._encoders, self._motor_status = codec("WheelEncoders"), codec("MotorStatus")
        self._known = known_identifiers()
        self._own = (self._command.arbitration_id, self._stop.arbitration_id)
        self._counter = 0
        self._sent: deque[bytes] = deque(maxlen=ECHOES)
        self._sequence = SequenceWatch()
        self._status: ControllerStatus | None = None
        self._believed = self._rejected = self._foreign = self._errors = 0

    def activate(self) -> None:
        board, silent_ns = self.env.board, to_ns(self.parameters.silent_s)
        self._silent_ns = silent_ns
        self._is_again = board.T_odom_robot is not None
        """The controller has spoken before: this is a restart, or a reload."""
        self._odometry = WheelOdometry(
            self.parameters.base, WHEEL_SPEED_MAX_RAD_S, board.T_odom_robot or Pose2D(0.0, 0.0, 0.0), board.wheel_ticks
        )
        self._frame_clock = FrameClock(self._stamped_at())
        self._broken: MotionFault | None = None
        self._acknowledged_ns: int | None = None
        self._heard_ns: int | None = None
        self._since_ns = self.env.clock.now_ns()
        self._silence = Silence(silent_ns)
        self._bus = self._open()
        self._port = frame_port(self._bus)
        self._pending = self._port.pending

    def step(self) -> None:
        if self._port is None:
            return
        try:
            self._catch_up()
            self._check()
        except MotionFault as fault:
            self.condition.notify(Condition(False, str(fault)))
            raise

    def deactivate(self) -> None:
        if self._bus is not None:
            self.stop()
            self._bus.shutdown()
            self._bus = self._port = None
            self._pending = ()

    def emergency_halt(self) -> None:
        self.stop()

    def drive(self, twist: Twist2D) -> None:
        """Command a velocity, body frame. It holds for 200 ms; beyond the wheels' limit its direction is kept."""
        if self._is_again and self._heard_ns is None:
            return  # it may hear and not be heard: no motion before it has spoken
        wanted = self.parameters.base.wheel_speeds_rad_s(twist)
        if not all(map(math.isfinite, wanted)):
            raise ValueError(f"expected a finite velocity, got {twist}")
        share = WHEEL_SPEED_MAX_RAD_S / max(WHEEL_SPEED_MAX_RAD_S, *map(abs, wanted))
        first, second, third = share * wanted[0], share * wanted[1], share * wanted[2]
        self._counter = (self._counter + 1) & 0xFF
        self._send(self._command, self._command.encode(self._counter, first, second, third))

    @external
    def stop(self) -> None:
        """Stop the wheels at once."""
        self._counter = (self._counter + 1) & 0xFF
        self._send(self._stop, self._stop.encode(self._counter, 0))

    @external
    def is_fresh(self) -> bool:
        """Whether the wheel encoders send data."""
        if self._pending:
            self._catch_up()
        return self._heard_ns is not None and self.env.clock.now_ns() - self._heard_ns <= self._silent_ns

    def pose(self) -> Pose2D:
        """T_odom_robot from the wheel encoders."""
        if self._pending:
            self._catch_up()
        return self._odometry.pose

    def pose_if_fresh(self) -> tuple[Pose2D, bool]:
        """`pose` and `is_fresh` in one call, for who asks many times a second."""
        if self._pending:
            self._catch_up()
        heard_ns = self._heard_ns
        is_fresh = heard_ns is not None and self.env.clock.now_ns() - heard_ns <= self._silent_ns
        return self._odometry.pose, is_fresh

    def pose_at(self, stamp_ns: int) -> Pose2D:
        """T_odom_robot at a time within the last five seconds, between the encoder frames before and after it."""
        if self._pending:
            self._catch_up()
        return self._odometry.pose_at(stamp_ns - self._frame_clock.offset_ns)

    def odometry_until_ns(self) -> int:
        """Time of measurement of the newest wheel counts; 0 before the first."""
        if self._pending:
            self._catch_up()
        until_ns = self._odometry.until_ns
        return until_ns + self._frame_clock.offset_ns if until_ns is not None else 0

    def velocity(self) -> Twist2D:
        """Velocity in the body frame, from the encoders."""
        if self._pending:
            self._catch_up()
        return self._odometry.velocity

    def radius_m(self) -> float:
        """Radius of the round footprint."""
        return self.parameters.radius_m

    @external
    def counters(self) -> Counters:
        """Frames believed, rejected, foreign and lost, and error frames."""
        if self._pending:
            self._catch_up()
        return Counters(self._believed, self._rejected, self._foreign, self._sequence.lost, self._errors)

    @external
    def status(self) -> ControllerStatus | None:
        """Last status of the motor controller; null before the first."""
        if self._pending:
            self._catch_up()
        return self._status

    def _stamped_at(self) -> StampedAt:
        wanted = self.parameters
        if wanted.stamped_at is not None:
            return wanted.stamped_at
        return StampedAt.SENDING if wanted.interface == STAMPS_SENDING else StampedAt.ARRIVAL

    def _open(self) -> can.BusABC:
        wanted = self.parameters
        return self.env.open_can(wanted.interface, wanted.channel, **wanted.options)

    def _send(self, codec: FrameCodec, data: bytes) -> None:
        if self._port is None:
            return
        self._sent.append(data)
        try:
            self._port.send_data(codec.arbitration_id, data)
        except (can.CanError, OSError) as error:
            # The caller is not to blame, and may be a halt: the device's own step tells of it.
            self._broken = BusFault(self.env.plugin, f"the CAN bus takes no frames: {error}")

    def _catch_up(self) -> None:
        """Read the frames that have arrived. The device's own step raises a fault of the bus, never a caller's call."""
        port = self._port
        if port is None or self._broken is not None:
            return
        try:
            self._listen(port)
        except MotionFault as fault:
            self._broken = fault

    def _listen(self, port: FramePort) -> None:
        try:
            frames = port.take_frames()
        except (can.CanError, OSError) as error:
            raise BusFault(self.env.plugin, f"the CAN bus cannot be read: {error}") from error
        encoders, status = self._encoders.arbitration_id, self._motor_status.arbitration_id
        for frame in frames:
            identifier = frame.identifier
            if identifier == encoders:
                self._read_encoders(frame)
            elif identifier & ERROR:
                self._read_error(frame)
            elif identifier == status:
                self._read_status(frame.data)
            elif identifier in self._own:
                self._foreign += frame.data not in self._sent
            elif identifier not in self._known:
                self._foreign += 1

    def _check(self) -> None:
        if self._broken is not None:
            raise self._broken
        since_ns = self._heard_ns
        if since_ns is None:
            if not self._is_again:
                return  # it has never spoken: it may still be starting, and the driver stands until it does
            since_ns = self._since_ns
        now_ns = self.env.clock.now_ns()
        if now_ns - since_ns <= self._silence.begins_ns:
            return
        silent_ns = self._silence.since(since_ns, now_ns)
        if silent_ns > self._silent_ns:
            where = f"{self.parameters.interface}:{self.parameters.channel}"
            raise BusFault(
                self.env.plugin,
                f"no encoder frame for {silent_ns / NS_PER_S:.2f} s: the CAN bus {where} is cut or its controller gone",
            )

    def _read_error(self, frame: Frame) -> None:
        self._errors += 1
        state = state_in(frame.identifier & ID_MASK, frame.data)
        if state is BusState.OFF:
            raise BusFault(self.env.plugin, "the computer's CAN controller is bus off")
        if state is BusState.PASSIVE:
            logger.warning("%s: the CAN bus is error passive: does another node acknowledge frames?", self.env.robot)

    def _read_status(self, data: bytes) -> None:
        try:
            signals = self._motor_status.decode(data)
        except BadFrame:
            self._rejected += 1
            return
        self._status = status = ControllerStatus(*map(int, signals[:-1]))
        if status.state != MOTOR_ERROR:
            return
        now_ns = self.env.clock.now_ns()
        if self._is_again and self._acknowledged_ns is None:
            self._acknowledged_ns = now_ns
            self.stop()
        elif self._acknowledged_ns is None or now_ns - self._acknowledged_ns > ACKNOWLEDGE_NS:
            raise MotorFault(self.env.plugin, "the motor controller reports that its power stage has failed")

    def _read_encoders(self, frame: Frame) -> None:
        try:
            first, second, third, counter = map(int, self._encoders.decode(frame.data))
        except BadFrame:
            self._rejected += 1
            return
        missing = self._sequence.note(counter)
        ticks = (first, second, third)
        now_ns = self.env.clock.now_ns()
        measured_ns = self._frame_clock.note(counter, frame.stamp_ns, now_ns)
        if self._odometry.take(ticks, measured_ns, missing):
            self._believed += 1
        else:
            self._rejected += 1
            self._frame_clock.start_anew()
        if self._heard_ns is None and self._is_again:
            self.condition.notify(Condition(True, "the motor controller speaks again"))
        self._heard_ns = now_ns
        board = self.env.board
        board.T_odom_robot, board.wheel_ticks = self._odometry.pose, ticks
