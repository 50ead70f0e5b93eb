"""A motor controller alone on a bus: its encoder counts and its status, as `RobotTeam` sends them for all robots."""

from collections.abc import Callable, Sequence

import can
import numpy as np

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.sim.firmware.motor_controller import ENCODER_IDENTIFIER, MotorController, WheelEncoders


class ControllerNode:
    """The controller, with encoders."""

    def __init__(
        self, bus: can.BusABC, base: OmniBase, tick_s: float, transmit_errors: Callable[[], int] = lambda: 0
    ) -> None:
        self.controller = MotorController(bus, base, tick_s, transmit_errors)
        self._bus = bus
        self._encoders = WheelEncoders(np.array([self.controller.ticks_per_rad]))
        self._ticks = 0

    def report(self, turns_rad: Sequence[float]) -> None:
        """Send the counts and, if it is due or has changed, the status."""
        (data,) = self._encoders.frames(np.array([turns_rad]))
        self._bus.send(can.Message(arbitration_id=ENCODER_IDENTIFIER, data=data, is_extended_id=False))
        self.controller.check_errors()
        if self.controller.has_news or self._ticks % self.controller.status_period_ticks == 0:
            self.controller.send_status()
        self._ticks += 1
