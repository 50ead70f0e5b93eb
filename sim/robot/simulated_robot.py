"""One simulated robot: a body on wheels, the nodes on its CAN bus, a battery and a lidar."""

from collections.abc import Sized

import numpy as np
import pymunk
from numpy.typing import NDArray

from robrain.algorithms.navigation.wheel_bases import Differential
from robrain.plugins.device.mocdevice.frame_clock import StampedAt
from robrain.protocol.can.frames import codec
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_SCAN, ARENA_SERIAL, ARENA_SERIAL_TX
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.sim.faults.fault_spec import FaultKind, FaultSpec
from robrain.sim.firmware.battery import BatteryManager, SimulatedBattery
from robrain.sim.firmware.bus_line import BusLine, FrameStamps, LineFault
from robrain.sim.firmware.described_controller import (
    BASE_LINE,
    DescribedController,
    FrameController,
    LineController,
    SerialPort,
    obeyed,
)
from robrain.sim.firmware.disturbance import Disturbance
from robrain.sim.firmware.lidar_line import LINE, LidarLine, LidarProtocol
from robrain.sim.firmware.motor_controller import MotorController
from robrain.sim.firmware.range_sensors import RangeSensors
from robrain.sim.firmware.wit_imu import IMU_LINE, WitImu
from robrain.sim.maps.surfaces import FloorSurfaces
from robrain.sim.robot.lidar import Lidar
from robrain.sim.robot.robot_body import RobotBody
from robrain.sim.robot.robot_hardware import ArenaRobot, Controller
from robrain.sim.robot.wheels import Wheels

CAN_CHANNEL = "can0"
STANDARD_MASK = 0x7FF
LIE_V, LIE_A, LIE_C = 16.7, 0.0, 22.0
"""A battery that reports full charge and no current, whatever the robot does."""
OBEYED = ("WheelCommand", "Stop")
"""Frames that the robot's nodes listen to; those of a described base listen to its commands."""


def _obeyed(spec: ArenaRobot) -> list[int]:
    if spec.controller is Controller.LINES:
        return []
    if spec.chassis is not None:
        return obeyed(spec.chassis)
    return [codec(name).arbitration_id for name in OBEYED]


class SimulatedRobot:
    """A body with its firmware and its lidar.

    `RobotTeam` moves it on together with others.

    Args:
        spec: its construction, and its start.
        space: space of its body.
        walls: (H, W) solid cells; writable, as it would be copied otherwise.
        geometry: placement of `walls` in the arena frame.
        endpoint: the arena's place on the wire.
        index: among the robots; they alternate, so that no tick has all the scans.
        tick_s: length of a tick.
        rng: the source of all its randomness.
        surfaces: glass and mirrors among the walls; None if there are none.
        disturbance: delays of frames and scans.

    """

    def __init__(
        self,
        spec: ArenaRobot,
        space: pymunk.Space,
        walls: NDArray[np.bool_],
        geometry: GridGeometry,
        endpoint: Endpoint,
        index: int,
        tick_s: float,
        rng: np.random.Generator,
        surfaces: FloorSurfaces | None,
        disturbance: Disturbance,
    ) -> None:
        battery_rng, (wheels_rng, ranges_rng) = rng.spawn(1)[0], rng.spawn(2)
        self.name = spec.name
        late_frames, stamps = disturbance.frames(index, endpoint.clock), None
        if late_frames is not None:
            stamps_sending = disturbance.spec.can.stamped_at is StampedAt.SENDING
            stamps = FrameStamps(endpoint.clock, stamps_sending=stamps_sending)
        self._late_scans = disturbance.scans(index, endpoint.clock)
        self.is_late = late_frames is not None or self._late_scans is not None
        """Whether frames or scans can be late, so that `deliver` must be called."""
        bus = ZenohBus(
            f"{spec.name}/{CAN_CHANNEL}",
            [{"can_id": number, "can_mask": STANDARD_MASK, "extended": False} for number in _obeyed(spec)],
            session=endpoint.session,
            team=endpoint.team,
            direct=endpoint.drive is Drive.LOCKSTEP,
            now_ns=endpoint.clock.now_ns if stamps is None else stamps.now_ns,
            on_outside=endpoint.record_outside,
        )
        self.pending: Sized = bus.pending
        """Empty if no frame waits for the motor controller."""
        self.bus = BusLine(bus, late_frames, stamps)
        wheels = Wheels.draw(spec.base, spec.wheels, wheels_rng)
        self.body = RobotBody(space, wheels, spec.start, spec.radius_m)
        self.battery = SimulatedBattery(spec.battery)
        self.power = spec.power
        self.lidar = Lidar(spec.lidar, spec.name, walls, geometry, rng, surfaces)
        self._scans = endpoint.publisher(ARENA_SCAN, robot=spec.name)
        self.line: LidarLine | None = None
        """The lidar's serial line, if it has one."""
        self._hulls: NDArray[np.float64] = np.zeros((0, 3))
        if spec.lidar.protocol is not LidarProtocol.WIRE:
            line = endpoint.publisher(ARENA_SERIAL, robot=spec.name, line=LINE)
            self.line = LidarLine(spec.lidar.protocol, spec.lidar.rate_hz, tick_s, self._measure, line.put_bytes)
        self._imu: WitImu | None = None
        if spec.imu is not None:
            self._imu = WitImu(spec.imu, rng.spawn(1)[0])
            self._put_imu = endpoint.publisher(ARENA_SERIAL, robot=spec.name, line=IMU_LINE).put_bytes
        self.has_imu = self._imu is not None
        """Whether `measure_turning` is to be called in each tick."""
        self._tick_s = tick_s
        self.scan_period_ticks = max(1, round(1.0 / (spec.lidar.rate_hz * tick_s)))
        self.scan_phase = index % self.scan_period_ticks if spec.has_lidar else -1
        """A turn of the lidar is complete with each tick that leaves this when it is divided by the period."""
        self.described: DescribedController | None = None
        """The controller, if it is that of a described base."""
        if isinstance(spec.chassis, Differential) and spec.controller is Controller.LINES:
            inbox = Inbox(capacity=256)
            endpoint.subscribe(inbox, ARENA_SERIAL_TX, robot=spec.name, line=BASE_LINE)
            port = SerialPort(inbox, endpoint.publisher(ARENA_SERIAL, robot=spec.name, line=BASE_LINE).put_bytes)
            self.pending = port
            self.described = LineController(port, self.bus, spec.chassis, spec.base, tick_s)
        elif spec.chassis is not None:
            self.described = FrameController(
                self.bus, spec.chassis, spec.base, tick_s, lambda: self.bus.transmit_errors
            )
        self.controller = self.described or MotorController(
            self.bus, spec.base, tick_s, lambda: self.bus.transmit_errors
        )
        self.ranges = RangeSensors(
            self.bus, spec.range_sensors, spec.radius_m, walls, geometry, ranges_rng, tick_s, index
        )
        self.manager = BatteryManager(self.bus, self.battery, spec.power, tick_s, battery_rng)
        self.controller.powered = not self.battery.is_cut_off

    def drop_commands(self) -> None:
        """Drop all frames that the robot's computer has sent and its nodes have not received."""
        self.bus.read_frames()
        if isinstance(self.described, LineController):
            self.described.forget()

    @property
    def delivered_j(self) -> float:
        """Energy that the battery has given so far."""
        return self.battery.delivered_j

    def supply(self, supply_w: float) -> None:
        """Charge with this power from now on."""
        self.manager.supply_w = supply_w

    def set_fault(self, fault: FaultSpec, *, breaks: bool) -> None:
        """Apply a fault now, or repair it."""
        match fault.kind:
            case FaultKind.CAN_CUT | FaultKind.CAN_SHORTED as kind:
                broken = LineFault.CUT if kind is FaultKind.CAN_CUT else LineFault.SHORTED
                self.bus.break_down(broken if breaks else LineFault.NONE)
            case FaultKind.MOTORS_FAIL:
                self.controller.has_failed = breaks
            case FaultKind.LIDAR_FREEZES:
                self.lidar.is_frozen = breaks
            case FaultKind.BATTERY_LIES:
                self.manager.lie = (lambda _: (LIE_V, LIE_A, LIE_C)) if breaks else None
            case FaultKind.CARRIED_OFF:
                assert fault.place_m is not None  # FaultSpec has checked it
                self.body.carry_to(Pose2D(*fault.place_m, fault.yaw_rad))
            case FaultKind.DRAIN:
                assert fault.soc is not None
                self.battery.drain(fault.soc)

    def scan(self, hulls: NDArray[np.float64]) -> None:
        """Send a turn of the lidar; `hulls` (K, 3) are x, y, radius of all robots, arena frame."""
        turn = self.lidar.scan(self.body.pose, hulls)
        if self._late_scans is None:
            self._scans.put(turn)
        else:
            self._late_scans.put(turn)

    def sweep(self, hulls: NDArray[np.float64]) -> None:
        """Let a lidar on a serial line turn for a tick; `hulls` as for `scan`."""
        if self.line is not None:
            self._hulls = hulls
            self.line.turn()

    def measure_turning(self) -> None:
        """Send the measurement of the inertial measurement unit in this tick."""
        if self._imu is not None and (data := self._imu.run(self.body.turned_rad / self._tick_s, self._tick_s)):
            self._put_imu(data)

    def _measure(self, angles_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.lidar.measure(self.body.pose, self._hulls, angles_rad)

    def deliver(self) -> None:
        """Pass on late frames and scans that have arrived; scans keep their time of measurement."""
        self.bus.deliver()
        for measured_ns, turn in self._late_scans.arrivals() if self._late_scans is not None else ():
            self._scans.put(turn, measured_ns)
