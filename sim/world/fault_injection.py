"""Faults of a scenario: at a time that is set, a robot's hardware breaks, and may be whole again later.

What breaks is the simulated hardware. The robot's plugins must find out for themselves.
"""

import math
from collections.abc import Mapping, Sequence
from enum import StrEnum

import msgspec

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.tinyos.packet import ActiveMessage
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.topics import ARENA_RADIO_RX
from robrain.sim.firmware.bus_line import LineFault
from robrain.sim.robot.simulated_robot import SimulatedRobot

FLOOD_PACKETS_A_TICK = 40
"""2,000 a second at 50 ticks; a Mica2's radio brings some 40."""
FLOOD_TYPE = 0xEE
LIE_V, LIE_A, LIE_C = 16.7, 0.0, 22.0
"""A battery that says to be full and to give nothing, whatever the robot does."""


class FaultKind(StrEnum):
    """What breaks."""

    CAN_CUT = "can_cut"
    """The CAN bus is cut: no frame passes, without an error."""
    CAN_SHORTED = "can_shorted"
    """The CAN bus is shorted: no frame passes, and the controllers go bus off."""
    MOTORS_FAIL = "motors_fail"
    """The motor controller's power stage fails, and its status says so."""
    LIDAR_FREEZES = "lidar_freezes"
    """The lidar repeats its last turn."""
    BATTERY_LIES = "battery_lies"
    """The battery manager reports a full battery at rest."""
    MOTE_BASE_FLOODS = "mote_base_floods"
    """The base station delivers thousands of packets a second."""
    CARRIED_OFF = "carried_off"
    """The robot is picked up and put down at `place_m`; its wheels do not turn."""


class FaultSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[[faults]]`: a robot's hardware fails at a given time. Raises ValueError where its times are not in order."""

    robot: str
    """Name of the robot, such as `r1`."""
    kind: FaultKind
    at_s: float
    """Simulated time at which it begins."""
    until_s: float | None = None
    """Simulated time at which it ends; never if absent."""
    place_m: tuple[float, float] | None = None
    """`carried_off`: where the robot is put down, x and y in the arena frame."""
    yaw_rad: float = 0.0
    """`carried_off`: the robot's yaw there."""

    def __post_init__(self) -> None:
        is_carried = self.kind is FaultKind.CARRIED_OFF
        if is_carried != (self.place_m is not None):
            raise ValueError(f"expected place_m for {FaultKind.CARRIED_OFF}, and for nothing else")
        if is_carried and self.until_s is not None:
            raise ValueError(f"expected no until_s for {FaultKind.CARRIED_OFF}: the robot stays where it is put down")
        if self.place_m is not None and not all(map(math.isfinite, (*self.place_m, self.yaw_rad))):
            raise ValueError(f"expected finite place_m and yaw_rad, got {self.place_m} and {self.yaw_rad}")
        if not self.at_s >= 0:
            raise ValueError(f"expected at_s >= 0, got {self.at_s}")
        if self.until_s is not None and not self.until_s > self.at_s:
            raise ValueError(f"expected until_s > at_s = {self.at_s:g}, got {self.until_s}")


class FaultSchedule:
    """Breaks and mends, tick by tick.

    Args:
        faults: of the scenario.
        arena: whose robots they are of.
        endpoint: what floods is put there.

    Raises:
        ValueError: a fault names a robot that there is not.

    """

    def __init__(self, faults: Sequence[FaultSpec], robots: Mapping[str, SimulatedRobot], endpoint: Endpoint) -> None:
        self._robots = robots
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
        """Whether there are any, so that `step` must be called."""
        self._noise = ActiveMessage(type=FLOOD_TYPE, payload=bytes(16), source=0).pack()

    def step(self, sim_time_s: float) -> None:
        """Break and mend what is due, and flood."""
        while self._waiting and self._waiting[0][0] <= sim_time_s + 1e-9:
            _, _, fault, breaks = self._waiting.pop(0)
            self._set(fault, breaks=breaks)
        for robot in self._flooding:
            for _ in range(FLOOD_PACKETS_A_TICK):
                self._floods[robot].put_bytes(self._noise)

    def _set(self, fault: FaultSpec, *, breaks: bool) -> None:
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
            case FaultKind.MOTE_BASE_FLOODS if breaks:
                self._flooding.append(name)
            case FaultKind.MOTE_BASE_FLOODS:
                self._flooding.remove(name)
