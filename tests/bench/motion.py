"""Motion on CAN: where a robot ends after a square of 5 m, how soon faults are named, and what the range sensors cost.

The square is that of Borenstein and Feng's UMBmark (IEEE Transactions on Robotics and Automation 12(6), 1996): four
times 5 m straight ahead and a quarter turn, as many times clockwise as counter-clockwise. Errors are true ones, by the
arena. `SEEDS = 50` is the full size.
"""

import logging
import math
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.algorithms.warm_up import warm_up
from robrain.lab.bench.figure import Figure, at_most, deterministic, timing
from robrain.protocol.clock import VirtualClock
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.firmware.bus_line import LineFault
from robrain.sim.firmware.range_sensors import RangeSensorSpec
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.robot.robot_hardware import ArenaRobot, RobotHardware
from robrain.sim.robot.wheels import WheelSpec
from robrain.sim.world.arena import Arena
from robrain.sim.world.world import World

SEEDS = 8
SIDE_M = 5.0
TICK_NS = 20_000_000
START = Pose2D(3.0, 3.0, 0.0)
ROOM_M, RESOLUTION_M = 11.0, 0.1
LONGEST_S = 120.0

SLIP = WheelSpec(slip_sigma_m_per_sqrt_m=0.003, lateral_sigma_m_per_sqrt_m=0.003)
BIAS = WheelSpec(radius_sigma=0.002, base_sigma=0.005)
BOTH = msgspec.structs.replace(SLIP, radius_sigma=BIAS.radius_sigma, base_sigma=BIAS.base_sigma)
"""Chosen: two per mille of a wheel's radius is 0.08 mm of 40."""


class Robot:
    """One robot in an empty hall, alone with its driver."""

    def __init__(self, hardware: RobotHardware, seed: int, start: Pose2D) -> None:
        cells = round(ROOM_M / RESOLUTION_M)
        occupied = np.ones((cells, cells), np.bool_)
        occupied[1:-1, 1:-1] = False
        plan = FloorPlan(occupied, RESOLUTION_M, 0.0, 0.0, "hall")
        self.session = open_lockstep_session()
        self.clock = VirtualClock()
        self.wire = Endpoint(self.session, "bench", self.clock, Drive.LOCKSTEP)
        robot = ArenaRobot(name="r1", start=start, **{name: getattr(hardware, name) for name in HARDWARE})
        self.arena = Arena(World(plan, [robot], [], seed), self.wire, rng=np.random.default_rng(seed))
        parameters = {"mocdevice": {"base": msgspec.to_builtins(hardware.base)}}
        robot_file = RobotFile(robot=RobotTable("r1", "bench", load=["driver"]), parameters=parameters)
        self.host = AgentHost(robot_file, Path(), self.session, self.clock, Drive.LOCKSTEP, seed=seed)
        self.host.start()
        self.run(0.5)

    @property
    def driver(self) -> Any:
        return self.host.manager.get("driver").live_plugin()

    @property
    def truth(self) -> Pose2D:
        return self.arena.truth.robots[0].pose

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 1e9 / TICK_NS)):
            self.clock.advance_to(self.clock.now_ns() + TICK_NS)
            self.arena.step()
            self.host.step()

    def run_until(self, is_so: Callable[[], bool]) -> float:
        began_ns = self.clock.now_ns()
        while not is_so():
            self.run(0.02)
            if self.clock.now_ns() - began_ns > LONGEST_S * 1e9:
                raise RuntimeError(f"not so after {LONGEST_S:g} s")
        return (self.clock.now_ns() - began_ns) / 1e9

    def act(self, name: str, *arguments: float) -> None:
        getattr(self.driver, name)(*arguments)
        self.run_until(lambda: self.driver.motion() == "stopped")

    def close(self) -> None:
        self.host.close()
        self.arena.close()
        self.wire.close()
        self.session.close()


HARDWARE = RobotHardware.__struct_fields__


@contextmanager
def robot_in_hall(hardware: RobotHardware, seed: int = 1, start: Pose2D = START) -> Iterator[Robot]:
    """A robot that is closed at the end of the block."""
    robot = Robot(hardware, seed, start)
    try:
        yield robot
    finally:
        robot.close()


def measure() -> list[Figure]:
    """All figures of motion."""
    warm_up()
    logging.disable(logging.ERROR)  # the faults are meant
    try:
        return [*_squares(), *_faults(), _range_sensor_cost()]
    finally:
        logging.disable(logging.NOTSET)


# -- the square -------------------------------------------------------------------------------------------------


class SquareError(NamedTuple):
    """Of one square."""

    odometry_m: float
    """Between where the odometry has the robot at the end, and where it is."""
    odometry_rad: float
    control_m: float
    """Between where the odometry has the robot, and where it should be."""


def square(hardware: RobotHardware, seed: int, *, clockwise: bool) -> SquareError:
    """Drive one square and see where it ends."""
    start = Pose2D(3.0, 8.0 if clockwise else 3.0, 0.0)
    with robot_in_hall(hardware, seed, start) as robot:
        place = Pose2D(0.0, 0.0, 0.0)
        for _ in range(4):
            place = place.compose(Pose2D(SIDE_M, 0.0, 0.0))
            robot.act("go_to", place.x_m, place.y_m, place.yaw_rad)
            place = place.compose(Pose2D(0.0, 0.0, -math.pi / 2 if clockwise else math.pi / 2))
            robot.act("go_to", place.x_m, place.y_m, place.yaw_rad)
        robot.run(0.5)
        truth = start.inverse().compose(robot.truth)
        odometry = robot.driver.pose()
    return SquareError(
        odometry.distance_m(truth),
        abs(math.remainder(odometry.yaw_rad - truth.yaw_rad, math.tau)),
        math.hypot(odometry.x_m, odometry.y_m),
    )


def _squares() -> list[Figure]:
    figures = []
    cases = (
        ("exact wheels", RobotHardware(), 1, 0.02),
        ("encoders of 64 ticks a turn", RobotHardware(base=OmniBase(encoder_ticks_per_turn=64)), 1, None),
        ("random slip, 3 mm after 1 m", RobotHardware(wheels=SLIP), SEEDS, None),
        ("wheels 0.2 %, base 0.5 % off", RobotHardware(wheels=BIAS), SEEDS, None),
        ("both", RobotHardware(wheels=BOTH), SEEDS, None),
    )
    for what, hardware, seeds, bound_m in cases:
        errors = [
            square(hardware, seed, clockwise=clockwise) for seed in range(1, seeds + 1) for clockwise in (False, True)
        ]
        rmse_m = math.sqrt(statistics.mean(error.odometry_m**2 for error in errors))
        worst_m = max(error.odometry_m for error in errors)
        yaw_deg = math.degrees(math.sqrt(statistics.mean(error.odometry_rad**2 for error in errors)))
        control_m = max(error.control_m for error in errors)
        bound = at_most(bound_m) if bound_m is not None else None
        beside = (
            f"RMSE {rmse_m:.3f} m, {yaw_deg:.2f}°, of {len(errors)} squares; off the square by its own odometry "
            f"{control_m:.3f} m"
        )
        figures.append(deterministic(f"5 m square, {what}: odometry off, worst", worst_m, "m", bound, beside))
    return figures


# -- faults -----------------------------------------------------------------------------------------------------


def _faults() -> list[Figure]:
    with robot_in_hall(RobotHardware()) as robot:
        robot.driver.drive(SIDE_M)
        robot.run(2.0)
        robot.arena.robot("r1").bus.break_down(LineFault.CUT)
        named_s = robot.run_until(lambda: robot.host.manager.get("mocdevice").state == "faulted")
        robot.run(0.5)
        place = robot.truth
        robot.run(2.0)
        moved_m = place.distance_m(robot.truth)
    cut = [
        deterministic("CAN bus cut at 0.6 m/s: fault named after", named_s, "s", at_most(0.5)),
        deterministic(
            "CAN bus cut at 0.6 m/s: way from half a second after that on", 1000 * moved_m, "mm", at_most(0.0)
        ),
    ]
    took_s = []
    for delay_s in np.linspace(0.0, 0.18, 10):
        with robot_in_hall(RobotHardware()) as robot:
            robot.driver.drive(SIDE_M)
            robot.run(2.0 + float(delay_s))
            robot.arena.robot("r1").lidar.is_frozen = True
            took_s.append(robot.run_until(lambda: robot.host.manager.get("scan").state == "faulted"))
    beside = f"median {statistics.median(took_s):.2f} s, of {len(took_s)}; a lidar of 5 Hz"
    frozen = deterministic("lidar frozen at 0.6 m/s: fault named after, worst", max(took_s), "s", at_most(0.8), beside)
    return [*cut, frozen]


# -- cost -------------------------------------------------------------------------------------------------------


def _range_sensor_cost(chunks: int = 60, chunk_s: float = 0.5) -> Figure:
    """CPU of the whole of one driving robot with and without the node, turn and turn about."""
    cost_ms: dict[bool, list[float]] = {True: [], False: []}
    bare = RobotHardware(range_sensors=RangeSensorSpec(angles_rad=()))
    with robot_in_hall(RobotHardware()) as ringed, robot_in_hall(bare) as without:
        robots = {True: ringed, False: without}
        for chunk in range(chunks):
            for has_ring, robot in robots.items():
                if robot.driver.motion() == "stopped":
                    robot.driver.go_to(*(((5.0, 0.0, 0.0), (5.0, 5.0, 1.5), (0.0, 0.0, 0.0))[chunk % 3]))
                began_s = time.process_time()
                robot.run(chunk_s)
                cost_ms[has_ring].append(1000.0 * (time.process_time() - began_s) / chunk_s)
    with_ms, without_ms = statistics.median(cost_ms[True]), statistics.median(cost_ms[False])
    what = "range sensors: CPU for each robot and simulated second"
    return timing(what, with_ms - without_ms, "ms", at_most(1.0), f"arena and driver without them {without_ms:.2f} ms")
