"""The motor controller: a node on the robot's CAN bus that turns commands into wheel speeds and counts the wheels.

It believes no frame whose length or checksum is wrong, and stops the wheels when commands cease.
"""

import math
from collections.abc import Sequence
from enum import IntEnum

import can

from robrain.protocol.can.frames import BadFrame, codec
from robrain.protocol.model.omni_drive import OmniBase

WATCHDOG_S = 0.2
ENCODER_PERIOD_S = 0.02
STATUS_PERIOD_S = 0.2
STANDING = (0.0, 0.0, 0.0)


class MotorState(IntEnum):
    """State of the controller, numbered as in the DBC file."""

    RUNNING = 0
    WATCHDOG = 1
    """No command in time: before the first one, after a stop, or 200 ms after the last."""
    LATCHED = 2
    """A latched stop refuses commands until a stop frame releases it."""


class MotorController:
    """Wheel commands and stops in, encoder counts and status out.

    A tick is `receive()`, and after the motion `report()`.

    Args:
        bus: the robot's bus; other nodes of the same robot may send on it too.
        base: what its encoders count in.
        tick_s: how long a tick is.

    """

    def __init__(self, bus: can.BusABC, base: OmniBase, tick_s: float) -> None:
        self.state = MotorState.WATCHDOG
        self.rejected_frames = 0
        """Frames with a wrong length or checksum; MotorStatus carries the lowest 8 bits."""
        self.powered = True
        """Without power the wheels stand; the controller's logic goes on."""
        self._wanted_rad_s = STANDING
        self._bus = bus
        self._ticks_per_rad = 1.0 / base.rad_per_tick
        self._watchdog_ticks = max(1, round(WATCHDOG_S / tick_s))
        self._encoder_period_ticks = max(1, round(ENCODER_PERIOD_S / tick_s))
        self._status_period_ticks = max(1, round(STATUS_PERIOD_S / tick_s))
        self._command, self._stop = codec("WheelCommand"), codec("Stop")
        self._encoders, self._status = codec("WheelEncoders"), codec("MotorStatus")
        self._ticks_since_command = 0
        self._tick = 0
        self._encoders_sent = 0
        self._status_sent = 0
        self._told: tuple[MotorState, int] | None = None

    @property
    def wheel_speeds_rad_s(self) -> tuple[float, float, float]:
        """What the wheels are to do now."""
        return self._wanted_rad_s if self.powered else STANDING

    def receive(self) -> None:
        """Take the frames that have arrived; then let the watchdog have its say."""
        self._ticks_since_command += 1
        while (frame := self._bus.recv(timeout=0)) is not None:
            try:
                self._obey(frame)
            except BadFrame:
                self.rejected_frames += 1
        if self.state is MotorState.RUNNING and self._ticks_since_command >= self._watchdog_ticks:
            self._stand(MotorState.WATCHDOG)

    def report(self, wheel_turns_rad: Sequence[float]) -> None:
        """Send what is due: encoder counts at 50 Hz, the status at 5 Hz and on change."""
        if self._tick % self._encoder_period_ticks == 0:
            counts = [math.floor(turns_rad * self._ticks_per_rad) & 0xFFFF for turns_rad in wheel_turns_rad]
            self._bus.send(
                self._encoders.pack(
                    self._encoders_sent, wheel_1_ticks=counts[0], wheel_2_ticks=counts[1], wheel_3_ticks=counts[2]
                )
            )
            self._encoders_sent += 1
        status = self.state, self.rejected_frames
        if status != self._told or self._tick % self._status_period_ticks == 0:
            self._told = status
            self._bus.send(
                self._status.pack(self._status_sent, state=self.state, rejected_frames=self.rejected_frames & 0xFF)
            )
            self._status_sent += 1
        self._tick += 1

    def _obey(self, frame: can.Message) -> None:
        if frame.is_extended_id or frame.is_remote_frame or frame.is_error_frame:
            return
        if frame.arbitration_id == self._command.arbitration_id:
            signals = self._command.unpack(frame)
            if self.state is not MotorState.LATCHED:
                self._wanted_rad_s = signals["wheel_1_rad_s"], signals["wheel_2_rad_s"], signals["wheel_3_rad_s"]
                self._ticks_since_command = 0
                self.state = MotorState.RUNNING
        elif frame.arbitration_id == self._stop.arbitration_id:
            latched = self._stop.unpack(frame)["latched"] != 0
            self._stand(MotorState.LATCHED if latched else MotorState.WATCHDOG)

    def _stand(self, state: MotorState) -> None:
        self._wanted_rad_s = STANDING
        self.state = state
