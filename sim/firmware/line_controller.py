"""A motor controller on a serial line that speaks as ROSArduinoBridge does: `m 12 12` drives, `e` asks for the counts.

Its speeds are counts in a cycle of its control loop, of 1/30 s. It stops the wheels when commands cease, as soon as one
on CAN does; the original waits for two seconds. It has no status: a failure of the power stage shows in the counts.
https://github.com/hbrobotics/ros_arduino_bridge, ROSArduinoBridge/commands.h.
"""

import re
from collections.abc import Callable, Sized

import can

from robrain.algorithms.navigation.wheel_bases import Differential, OmniBase
from robrain.protocol.links.inbox import Inbox
from robrain.sim.firmware.described_controller import DescribedController
from robrain.sim.firmware.motor_controller import MotorState

BASE_LINE = "base"
"""Name of the line."""
CYCLES_PER_S = 30.0
LINE_BYTES_MAX = 64
"""Length of the controller's buffer; a longer line is none."""
COMMAND = re.compile(rb"m (-?\d{1,6}) (-?\d{1,6})")
OBEYED, UNKNOWN = b"OK\r\n", b"Invalid Command\r\n"


class SerialPort(Sized):
    """The controller's end of the line: what has arrived, and what it sends.

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
        """What has arrived since the last call."""
        return b"".join(data for _, _, data in self._inbox.drain_raw())


class LineController(DescribedController):
    """See DescribedController; a base of two wheels.

    Args:
        port: its serial line.
        bus: of the robot's other nodes.
        base: the wheels.
        hull: the wheels by which the simulated body moves.
        tick_s: how long a tick is.

    """

    def __init__(self, port: SerialPort, bus: can.BusABC, base: Differential, hull: OmniBase, tick_s: float) -> None:
        super().__init__(bus, base, hull, tick_s, lambda: 0)
        self._line = port
        self._rad_s = CYCLES_PER_S * base.rad_per_tick
        """Speed of a wheel that turns by a count in a cycle."""
        self._left = b""

    def receive(self, tick: int | None = None) -> None:
        """As MotorController."""
        self._received_tick = tick = self._received_tick + 1 if tick is None else tick
        if self.has_failed:
            self._stand(MotorState.ERROR)
        elif self.state is MotorState.ERROR:
            self._stand(MotorState.WATCHDOG)
        *lines, self._left = (self._left + self._line.read()).split(b"\r")
        for line in lines:
            if answer := self._answer(line.strip()) if len(line) <= LINE_BYTES_MAX else UNKNOWN:
                self._line.put(answer)
        if len(self._left) > LINE_BYTES_MAX:
            self._left = b""
            self.rejected_frames += 1
        if tick >= self.due_tick:
            self._stand(MotorState.WATCHDOG)

    def forget(self) -> None:
        """Drop what has arrived."""
        self._line.read()
        self._left = b""

    def tell(self) -> None:
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
            self._stand(MotorState.WATCHDOG)
        elif not self.has_failed:
            self._turn([count * self._rad_s for count in counts])
        return OBEYED
