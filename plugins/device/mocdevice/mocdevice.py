"""Motor controller of a base with three omni wheels: commands and encoder odometry over CAN."""

import math
from bisect import bisect_left
from collections import deque

import can
import msgspec

from robrain.agent.plugin import Device, external
from robrain.plugins.device.mocdevice.interface import MocDeviceInterface
from robrain.protocol.can.frames import BadFrame, codec
from robrain.protocol.model.geometry import Pose2D, Twist2D
from robrain.protocol.model.odometry import moved
from robrain.protocol.model.omni_drive import OmniBase
from robrain.protocol.wire.clock import NS_PER_S

ENCODER_MODULUS = 1 << 16
WHEEL_SPEED_MAX_RAD_S = 32.0
"""The most that a WheelCommand frame can say."""
HISTORY_FRAMES = 64


class Counters(msgspec.Struct, frozen=True):
    """What the device has seen on its bus."""

    believed: int
    rejected: int
    foreign: int


class MocDevice(Device):
    """Turns velocities into wheel commands and encoder counts into odometry."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """`interface` and `channel` are python-can's; wheel sizes are chosen, no data sheet was found."""

        interface: str = "zenoh"
        channel: str = "can0"
        radius_m: float = 0.20
        base: OmniBase = OmniBase()
        wheel_speed_limit_rad_s: float = 30.0

    interface = MocDeviceInterface
    period_s = 0.02
    parameters: Parameters

    def init(self) -> None:
        self._bus: can.BusABC | None = None
        self._command = codec("WheelCommand")
        self._stop = codec("Stop")
        self._encoders = codec("WheelEncoders")
        self._status_id = codec("MotorStatus").arbitration_id
        self._counter = 0
        self._ticks: tuple[int, int, int] | None = None
        self._stamp_ns = 0
        self._pose = Pose2D(0.0, 0.0, 0.0)
        self._velocity = Twist2D()
        self._history: deque[tuple[int, Pose2D]] = deque(maxlen=HISTORY_FRAMES)
        self._believed = self._rejected = self._foreign = 0

    def activate(self) -> None:
        self._bus = self.env.open_can(self.parameters.interface, self.parameters.channel)

    def step(self) -> None:
        if self._bus is None:
            return
        while (frame := self._bus.recv(timeout=0)) is not None:
            if frame.is_extended_id or frame.is_remote_frame or frame.is_error_frame:
                self._foreign += 1
            elif frame.arbitration_id == self._encoders.arbitration_id:
                self._read_encoders(frame)
            elif frame.arbitration_id != self._status_id:
                self._foreign += 1

    def deactivate(self) -> None:
        if self._bus is not None:
            self.stop()
            self._bus.shutdown()
            self._bus = None

    def emergency_halt(self) -> None:
        self.stop()

    def drive(self, twist: Twist2D) -> None:
        """Command a velocity, body frame. It holds for 200 ms; beyond the wheels' limit its direction is kept."""
        wanted = self.parameters.base.wheel_speeds_rad_s(twist)
        share = WHEEL_SPEED_MAX_RAD_S / max(WHEEL_SPEED_MAX_RAD_S, *map(abs, wanted))
        first, second, third = (share * speed_rad_s for speed_rad_s in wanted)
        self._counter = (self._counter + 1) & 0xFF
        self._send(self._command.pack(self._counter, wheel_1_rad_s=first, wheel_2_rad_s=second, wheel_3_rad_s=third))

    @external
    def stop(self) -> None:
        """Stop the wheels at once."""
        self._counter = (self._counter + 1) & 0xFF
        self._send(self._stop.pack(self._counter, latched=0))

    def pose(self) -> Pose2D:
        """T_odom_robot from the wheel encoders."""
        return self._pose

    def pose_at(self, stamp_ns: int) -> Pose2D:
        """T_odom_robot at a time within the last second: of the encoder frame nearest to it."""
        history = self._history
        if not history or stamp_ns >= history[-1][0]:
            return self._pose
        index = bisect_left(history, stamp_ns, key=lambda entry: entry[0])
        if index > 0 and stamp_ns - history[index - 1][0] < history[index][0] - stamp_ns:
            index -= 1
        return history[index][1]

    def velocity(self) -> Twist2D:
        """Velocity in the body frame, from the encoders."""
        return self._velocity

    def radius_m(self) -> float:
        """Radius of the round footprint."""
        return self.parameters.radius_m

    @external
    def counters(self) -> Counters:
        """Frames believed, rejected (length or checksum) and foreign."""
        return Counters(self._believed, self._rejected, self._foreign)

    def _within_limits(self, speeds_rad_s: tuple[float, float, float]) -> tuple[float, float, float]:
        """Slower in the same direction, if a wheel could not turn as fast."""
        fastest_rad_s = max(abs(speed) for speed in speeds_rad_s)
        limit_rad_s = self.parameters.wheel_speed_limit_rad_s
        if fastest_rad_s <= limit_rad_s:
            return speeds_rad_s
        if not math.isfinite(fastest_rad_s):
            raise ValueError(f"expected a finite velocity, got wheel speeds of {speeds_rad_s} rad/s")
        share = limit_rad_s / fastest_rad_s
        return speeds_rad_s[0] * share, speeds_rad_s[1] * share, speeds_rad_s[2] * share

    def _send(self, frame: can.Message) -> None:
        if self._bus is not None:
            self._bus.send(frame)

    def _read_encoders(self, frame: can.Message) -> None:
        try:
            signals = self._encoders.unpack(frame)
        except BadFrame:
            self._rejected += 1
            return
        self._believed += 1
        ticks = (int(signals["wheel_1_ticks"]), int(signals["wheel_2_ticks"]), int(signals["wheel_3_ticks"]))
        stamp_ns = round(frame.timestamp * NS_PER_S)
        before, self._ticks = self._ticks, ticks
        elapsed_s = (stamp_ns - self._stamp_ns) / NS_PER_S
        self._stamp_ns = stamp_ns
        if before is not None and ticks != before:
            turns = [
                _wrapped(now - then) * self.parameters.base.rad_per_tick
                for now, then in zip(ticks, before, strict=True)
            ]
            displacement = self.parameters.base.twist(*turns)
            self._pose = moved(self._pose, displacement)
            if elapsed_s > 0:
                self._velocity = Twist2D(
                    displacement.forward_m_s / elapsed_s,
                    displacement.left_m_s / elapsed_s,
                    displacement.yaw_rad_s / elapsed_s,
                )
        else:
            self._velocity = Twist2D()
        self._history.append((stamp_ns, self._pose))


def _wrapped(ticks: int) -> int:
    """The shortest way round a 16-bit counter."""
    return (ticks + ENCODER_MODULUS // 2) % ENCODER_MODULUS - ENCODER_MODULUS // 2
