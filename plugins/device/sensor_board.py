"""Sensor board: the measurements of a mote, made by the robot itself on request.

Only the simulator's exists: another board is another class with the same interface.
"""

from typing import Protocol

import msgspec

from robrain.agent.errors import HardwareAbsent
from robrain.agent.plugin import Device, external
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.messages.team.arena_messages import ARENA_SENSE
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import Positive


class Sensed(msgspec.Struct, frozen=True, kw_only=True):
    """Measurements at the robot's place; names as in `MoteReading`, with the unit."""

    values: dict[str, float]
    stamp_ns: int


class SensorBoardInterface(Protocol):
    """Measures the quantities of motes, on request."""

    def measure(self) -> Sensed:
        """Measure now.

        Raises:
            CallError: the board does not answer; the text is the reason.

        """


class SensorBoard(Device):
    """Measures at the robot's place, on request."""

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """`interface` is `zenoh`, the simulator."""

        interface: str = "zenoh"
        timeout_s: Positive = 1.0

    interface = SensorBoardInterface
    parameters: Parameters

    def activate(self) -> None:
        if self.parameters.interface != "zenoh":
            raise HardwareAbsent(self.env.plugin, f"expected interface zenoh, got {self.parameters.interface!r}")

    @external
    def measure(self) -> Sensed:
        """Measure now."""
        try:
            values = self.env.wire.ask(ARENA_SENSE, robot=self.env.robot, timeout_s=self.parameters.timeout_s)
        except NobodyThere as error:
            raise CallError(ErrorCode.FAILED, f"no sensor board answers: {error}") from error
        return Sensed(values=values, stamp_ns=self.env.clock.now_ns())
