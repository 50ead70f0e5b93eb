"""Hardware faults of a scenario: a robot's hardware breaks, and may be whole again later.

What breaks is the simulated hardware. The robot's plugins must find out for themselves.
"""

from collections.abc import Mapping, Sequence

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.tinyos.packet import ActiveMessage
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.topics import ARENA_RADIO_RX
from robrain.sim.faults.fault_spec import FaultKind, FaultSpec
from robrain.sim.firmware.bus_line import LineFault
from robrain.sim.robot.simulated_robot import SimulatedRobot

FLOOD_PACKETS_A_TICK = 40
"""2,000 a second at 50 ticks; a Mica2's radio brings some 40."""
FLOOD_TYPE = 0xEE
LIE_V, LIE_A, LIE_C = 16.7, 0.0, 22.0
"""A battery that says to be full and to give nothing, whatever the robot does."""


class FaultSchedule:
    """Breaks and mends, tick by tick.

    Args:
        faults: of hardware, at set times.
        robots: that they are of.
        endpoint: what floods is put there.

    Raises:
        ValueError: a fault names a robot that there is not.

    """

    def __init__(self, faults: Sequence[FaultSpec], robots: Mapping[str, SimulatedRobot], endpoint: Endpoint) -> None:
        self._robots = robots
        self._endpoint = endpoint
        self._waiting: list[tuple[float, int, FaultSpec, bool]] = []
        for number, fault in enumerate(faults):
            self._waiting.append((fault.at_s, number, fault, True))
            if fault.until_s is not None:
                self._waiting.append((fault.until_s, number, fault, False))
        self._waiting.sort(key=lambda due: due[:2])
        self._floods = {
            fault.robot: endpoint.publisher(ARENA_RADIO_RX, robot=fault.robot)
            for fault in faults
            if fault.kind is FaultKind.MOTE_BASE_FLOODS
        }
        self._flooding: list[str] = []
        self.is_on = bool(faults)
        """Whether `step` must be called."""
        self._noise = ActiveMessage(type=FLOOD_TYPE, payload=bytes(16), source=0).pack()

    def step(self, sim_time_s: float) -> None:
        """Break and mend what is due, and flood."""
        while self._waiting and self._waiting[0][0] <= sim_time_s + 1e-9:
            _, _, fault, breaks = self._waiting.pop(0)
            self.set(fault, breaks=breaks)
        for robot in self._flooding:
            for _ in range(FLOOD_PACKETS_A_TICK):
                self._floods[robot].put_bytes(self._noise)

    def set(self, fault: FaultSpec, *, breaks: bool) -> None:
        """Break something now, or mend it."""
        name = fault.robot
        robot = self._robots[name]
        match fault.kind:
            case FaultKind.CAN_CUT:
                robot.bus.break_down(LineFault.CUT if breaks else LineFault.NONE)
            case FaultKind.CAN_SHORTED:
                robot.bus.break_down(LineFault.SHORTED if breaks else LineFault.NONE)
            case FaultKind.MOTORS_FAIL:
                robot.controller.has_failed = breaks
            case FaultKind.LIDAR_FREEZES:
                robot.lidar.is_frozen = breaks
            case FaultKind.BATTERY_LIES:
                robot.manager.lie = (lambda _: (LIE_V, LIE_A, LIE_C)) if breaks else None
            case FaultKind.CARRIED_OFF:
                assert fault.place_m is not None  # FaultSpec has checked it
                robot.body.carry_to(Pose2D(*fault.place_m, fault.yaw_rad))
            case FaultKind.DRAIN:
                assert fault.soc is not None
                robot.battery.drain(fault.soc)
            case FaultKind.MOTE_BASE_FLOODS if breaks:
                if name not in self._floods:
                    self._floods[name] = self._endpoint.publisher(ARENA_RADIO_RX, robot=name)
                self.is_on = True
                self._flooding.append(name)
            case FaultKind.MOTE_BASE_FLOODS:
                self._flooding.remove(name)
