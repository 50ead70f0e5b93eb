"""The motor controller: a node on the robot's CAN bus that turns commands into wheel speeds and counts the wheels.

It rejects each frame whose length or checksum is wrong. It counts missing frames by the gaps in their counter, and
stops the wheels when commands cease.
"""

import math
from collections.abc import Callable
from enum import IntEnum

import can
import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.can.bus_state import MOST_ERRORS, BusState, state_of
from robrain.protocol.can.frame_port import frame_port
from robrain.protocol.can.frames import BadFrame, codec
from robrain.protocol.can.payload import SequenceCounter

WHEELS = 3
ENCODER_FRAME = "WheelEncoders"
ENCODER_IDENTIFIER: int = codec(ENCODER_FRAME).arbitration_id
FRAME_BYTES = 2 * WHEELS + 2


class WheelEncoders:
    """Counts the ticks of the wheels' turns, 16 bits that wrap, and makes the frames that carry them.

    Args:
        ticks_per_rad: (N,) resolution of each robot's encoders.

    """

    def __init__(self, ticks_per_rad: Floats) -> None:
        self._ticks_per_rad = ticks_per_rad
        frame = codec(ENCODER_FRAME)
        self._crc_start, self._crc_table = frame.crc_start, np.array(frame.crc_table, np.uint8)
        self._sent = 0

    def frames(self, turns_rad: Floats) -> list[bytes]:
        """The next frame of each robot, for (N, 3) turns of the wheels since the start."""
        data = _frames(turns_rad, self._ticks_per_rad, self._sent & 0xFF, self._crc_start, self._crc_table).tobytes()
        self._sent += 1
        return [data[first : first + FRAME_BYTES] for first in range(0, len(data), FRAME_BYTES)]


@njit(cache=True)
def _frames(
    turns_rad: Floats, ticks_per_rad: Floats, counter: int, crc_start: int, crc_table: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """(N, 8) bytes as of the DBC file: three counts of 16 bits, the lowest byte first, counter and checksum."""
    frames = np.empty((turns_rad.shape[0], FRAME_BYTES), np.uint8)
    for i in range(turns_rad.shape[0]):
        frame = frames[i]
        for wheel in range(WHEELS):
            count = math.floor(turns_rad[i, wheel] * ticks_per_rad[i]) & 0xFFFF
            frame[2 * wheel] = count & 0xFF
            frame[2 * wheel + 1] = count >> 8
        frame[FRAME_BYTES - 2] = counter
        register = crc_start
        for place in range(FRAME_BYTES - 1):
            register = crc_table[register ^ frame[place]]
        frame[FRAME_BYTES - 1] = register ^ 0xFF
    return frames


WATCHDOG_S = 0.2
ENCODER_PERIOD_S = 0.02
STATUS_PERIOD_S = 0.2
STOPPED = (0.0, 0.0, 0.0)
NEVER = 1 << 62
"""A tick that does not come."""


class MotorState(IntEnum):
    """State of the controller, numbered as in the DBC file."""

    RUNNING = 0
    WATCHDOG = 1
    """No command in time: before the first one, after a stop, or 200 ms after the last."""
    LATCHED = 2
    """A latched stop refuses commands until a stop frame releases it."""
    ERROR = 3
    """The motors' power stage has failed; a stop frame that does not latch acknowledges it, once the cause has gone."""


class MotorController:
    """Wheel commands and stops in, encoder counts and status out.

    Call `receive()` in each tick, unless no frame has arrived, `has_failed` is not set and `due_tick` is not reached.
    After the motion `WheelEncoders` makes the frames with the counts, and `send_status()` sends the status.

    Args:
        bus: the robot's bus; other nodes of the same robot may send on it too.
        base: description of its encoder counts.
        tick_s: length of a tick.
        transmit_errors: gives the error counter of the node's CAN controller; none without it.

    """

    def __init__(
        self, bus: can.BusABC, base: OmniBase, tick_s: float, transmit_errors: Callable[[], int] = lambda: 0
    ) -> None:
        self.state = MotorState.WATCHDOG
        self.rejected_frames = 0
        """Frames with a wrong length or checksum; MotorStatus carries the lowest 8 bits."""
        self.powered = True
        """Without power the wheels stand; the controller's logic continues."""
        self.has_failed = False
        """The power stage, while the cause of its failure lasts."""
        self.due_tick = NEVER
        """Time at which the watchdog stops the wheels unless a command comes."""
        self.has_news = True
        """Whether the content of the status has changed since the last one."""
        self._commands = SequenceCounter()
        self._transmit_errors = transmit_errors
        self._worst = BusState.ACTIVE
        """The worst state of the CAN controller since the last status."""
        self._wanted_rad_s = STOPPED
        self._port = frame_port(bus)
        self.ticks_per_rad = 1.0 / base.rad_per_tick
        self.encoder_period_ticks = max(1, round(ENCODER_PERIOD_S / tick_s))
        self.status_period_ticks = max(1, round(STATUS_PERIOD_S / tick_s))
        self._watchdog_ticks = max(1, round(WATCHDOG_S / tick_s))
        self._command, self._stop = codec("WheelCommand"), codec("Stop")
        self._status = codec("MotorStatus")
        self._received_tick = 0
        self._status_sent = 0

    @property
    def wheel_speeds_rad_s(self) -> tuple[float, float, float]:
        """Current command of the wheels."""
        return self._wanted_rad_s if self.powered else STOPPED

    def receive(self, tick: int | None = None) -> None:
        """Handle the frames that have arrived; then check the watchdog.

        Args:
            tick: number of this tick; by default the one after that of the last call.

        """
        self._received_tick = tick = self._received_tick + 1 if tick is None else tick
        before = self.state, self.rejected_frames, self._commands.lost
        if self.has_failed:
            self._stop_wheels(MotorState.ERROR)
        self._read_commands()
        if tick >= self.due_tick:
            self._stop_wheels(MotorState.WATCHDOG)
        if before != (self.state, self.rejected_frames, self._commands.lost):
            self.has_news = True

    def _read_commands(self) -> None:
        for identifier, data, _ in self._port.read_frames():
            try:
                if identifier == self._command.arbitration_id:
                    self._drive(*self._command.decode(data))
                elif identifier == self._stop.arbitration_id:
                    self._stop_by(*self._stop.decode(data))
            except BadFrame:
                self.rejected_frames += 1

    def check_errors(self) -> None:
        """Check the error counter; due in each tick in which it is not 0."""
        errors = self._transmit_errors()
        if errors:
            self._worst = max(self._worst, state_of(errors, 0))

    def send_status(self) -> None:
        """Send the status."""
        self.has_news = False
        errors = self._transmit_errors()
        data = self._status.encode(
            self._status_sent,
            self.state,
            self.rejected_frames & 0xFF,
            self._commands.lost & 0xFF,
            self._worst,
            min(errors, MOST_ERRORS),
            0,  # receive errors
        )
        self._port.send_data(self._status.arbitration_id, data)
        self._status_sent += 1
        errors = self._transmit_errors()
        if not errors or state_of(errors, 0) is BusState.ACTIVE:
            self._worst = BusState.ACTIVE

    def _drive(self, first: float, second: float, third: float, counter: float) -> None:
        self._commands.record(int(counter))
        if self.state not in (MotorState.LATCHED, MotorState.ERROR):
            self._wanted_rad_s = first, second, third
            self.due_tick = self._received_tick + self._watchdog_ticks
            self.state = MotorState.RUNNING

    def _stop_by(self, latched: float, counter: float) -> None:
        self._commands.record(int(counter))  # a host counts its commands and stops together
        if not self.has_failed:
            self._stop_wheels(MotorState.LATCHED if latched else MotorState.WATCHDOG)

    def _stop_wheels(self, state: MotorState) -> None:
        self._wanted_rad_s = STOPPED
        self.due_tick = NEVER
        self.state = state
