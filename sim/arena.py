"""The arena: one tick of a simulated world after another, the same in lockstep and in live.

Robots are driven by frames on their CAN buses and by nothing else. The arena counts ticks; its owner calls `step()`
once a tick and moves the clock that stamps what is sent.
"""

import math
from collections.abc import Sequence

import msgspec
import numpy as np
import pymunk

from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.occupancy_grid import GridGeometry
from robrain.protocol.model.omni_drive import OmniBase
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.messages import ArenaClock, ArenaTruth, MoteTruth, RobotTruth
from robrain.protocol.wire.topics import ARENA_CLOCK, ARENA_SCAN, ARENA_TRUTH
from robrain.sim.firmware.battery import Battery
from robrain.sim.firmware.battery_manager import BatteryManager
from robrain.sim.firmware.motor_controller import MotorController
from robrain.sim.firmware.power_model import PowerModel
from robrain.sim.lidar import Lidar, LidarSpec
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.maps.wall_shapes import add_walls
from robrain.sim.motes import ArenaMote, MoteField, TemperatureField
from robrain.sim.referee import Referee, team_geometry
from robrain.sim.robot_body import (
    COLLISION_SLOP_M,
    MASS_KG,
    OVERLAP_LEFT_PER_TICK,
    WALL_COLLISION,
    CollisionCounter,
    RobotBody,
)

TICK_S = 0.02
CLOCK_PERIOD_S = 0.1
TRUTH_PERIOD_S = 0.2
CAN_CHANNEL = "can0"


class ArenaRobot(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A robot to be simulated; its nodes sit on the bus `{name}/can0`.

    Raises ValueError where it is built with a radius or a battery that is not above 0.
    """

    name: str
    start: Pose2D
    base: OmniBase = OmniBase()
    radius_m: float = 0.2
    battery_wh: float = 20.0
    power: PowerModel = PowerModel()
    lidar: LidarSpec = LidarSpec()

    def __post_init__(self) -> None:
        for name in ("radius_m", "battery_wh"):
            if not getattr(self, name) > 0:
                raise ValueError(f"expected {name} > 0, got {getattr(self, name)} (robot {self.name})")


class Arena:
    """Walls, robots and motes, moved on tick by tick.

    Randomness is spawned from `rng` by place: robots, motes and links keep theirs when others are added after them.

    Args:
        plan: the floor and its walls.
        robots: in this order; each starts clear of walls and of the others.
        motes: in this order.
        endpoint: says everything that the arena says; its owner closes it after the arena.
        rng: the source of all randomness.
        tick_s: how long a tick is.
        field: what the motes sense; a plume about a place drawn from `rng` without it.

    Raises:
        ValueError: a name is there twice, or a robot's start is taken.

    """

    def __init__(
        self,
        plan: FloorPlan,
        robots: Sequence[ArenaRobot],
        motes: Sequence[ArenaMote],
        endpoint: Endpoint,
        rng: np.random.Generator,
        *,
        tick_s: float = TICK_S,
        field: TemperatureField | None = None,
    ) -> None:
        _check_names([robot.name for robot in robots], "robot")
        _check_names([mote.name for mote in motes], "mote")
        _check_starts(plan, robots)
        robots_rng, motes_rng, field_rng = rng.spawn(3)

        self.tick_s = tick_s
        self._ticks = 0
        self._space = pymunk.Space()
        self._space.collision_slop = COLLISION_SLOP_M
        self._space.collision_bias = OVERLAP_LEFT_PER_TICK ** (1.0 / tick_s)
        add_walls(self._space, plan, collision_type=WALL_COLLISION)

        walls = plan.occupied.copy()
        rows, columns = walls.shape
        geometry = GridGeometry(plan.resolution_m, plan.origin_x_m, plan.origin_y_m, columns, rows)
        self._robots = [
            _Robot(spec, self._space, Lidar(spec.lidar, spec.name, walls, geometry, noise_rng), endpoint, index, tick_s)
            for index, (spec, noise_rng) in enumerate(zip(robots, robots_rng.spawn(len(robots)), strict=True))
        ]
        self._bodies = [robot.body for robot in self._robots]
        self._collisions = CollisionCounter(self._space, self._bodies, tick_s)
        self._hulls = np.zeros((len(robots), 3))
        """x, y, radius of each robot, arena frame; filled in when somebody scans."""
        self._hulls[:, 2] = [robot.radius_m for robot in robots]

        self._motes = MoteField(
            motes,
            [robot.name for robot in robots],
            field if field is not None else TemperatureField.draw(plan, field_rng),
            endpoint,
            motes_rng,
            tick_s,
        )
        self._mote_truths = [MoteTruth(mote=mote.name, place=mote.place) for mote in motes]
        starts = [Point2D(robot.start.x_m, robot.start.y_m) for robot in robots]
        radius_m = min((robot.radius_m for robot in robots), default=0.0)
        self.referee = Referee(plan, starts, radius_m, team_geometry(plan), endpoint)
        self._clock_publisher = endpoint.publisher(ARENA_CLOCK)
        self._truth_publisher = endpoint.publisher(ARENA_TRUTH)
        self._clock_period_ticks = max(1, round(CLOCK_PERIOD_S / tick_s))
        self._truth_period_ticks = max(1, round(TRUTH_PERIOD_S / tick_s))

    @property
    def sim_time_s(self) -> float:
        """Time simulated so far: ticks times `tick_s`."""
        return self._ticks * self.tick_s

    @property
    def collisions(self) -> int:
        """Sum of all robots' collisions; two that meet count one each."""
        return sum(self._collisions.count)

    @property
    def truth(self) -> ArenaTruth:
        """The world as it is now."""
        return ArenaTruth(
            sim_time_s=self.sim_time_s,
            robots=[
                RobotTruth(
                    robot=robot.name,
                    pose=robot.body.pose,
                    collisions=collisions,
                    distance_m=robot.body.distance_m,
                    energy_j=robot.battery.used_j,
                )
                for robot, collisions in zip(self._robots, self._collisions.count, strict=True)
            ],
            motes=self._mote_truths,
            explored_fraction=self.referee.explored_fraction,
        )

    def step(self) -> None:
        """One tick: firmware hears its bus, bodies move, firmware and sensors speak."""
        for robot in self._robots:
            robot.act()
        self._space.step(self.tick_s)
        self._collisions.step()
        self._ticks += 1
        for robot in self._robots:
            robot.report()
        self._scan()
        self._motes.step(self._bodies)
        if self._ticks % self._clock_period_ticks == 0:
            self._clock_publisher.put(ArenaClock(sim_time_s=self.sim_time_s))
        if self._ticks % self._truth_period_ticks == 0:
            self.referee.step()
            self._truth_publisher.put(self.truth)

    def close(self) -> None:
        """Leave the robots' buses."""
        for robot in self._robots:
            robot.bus.shutdown()

    def _scan(self) -> None:
        due = [robot for robot in self._robots if robot.scans_at(self._ticks)]
        if not due:
            return
        self._hulls[:, :2] = [(body.x_m, body.y_m) for body in self._bodies]
        for robot in due:
            robot.scan_publisher.put(robot.lidar.scan(robot.body.pose, self._hulls))


class _Robot:
    """A body with its firmware and its lidar."""

    def __init__(
        self, spec: ArenaRobot, space: pymunk.Space, lidar: Lidar, endpoint: Endpoint, index: int, tick_s: float
    ) -> None:
        self.name = spec.name
        self.bus = ZenohBus(
            f"{spec.name}/{CAN_CHANNEL}",
            session=endpoint.session,
            team=endpoint.team,
            direct=endpoint.drive is Drive.LOCKSTEP,
            now_ns=endpoint.clock.now_ns,
            on_outside=endpoint.note_outside,
        )
        self.body = RobotBody(space, spec.base, spec.start, spec.radius_m, tick_s)
        self.battery = Battery(spec.battery_wh)
        self.lidar = lidar
        self.scan_publisher = endpoint.publisher(ARENA_SCAN, robot=spec.name)
        self._scan_period_ticks = max(1, round(1.0 / (spec.lidar.rate_hz * tick_s)))
        # Robots take turns, so that no tick has all the scans.
        self._scan_phase = index % self._scan_period_ticks
        self._controller = MotorController(self.bus, spec.base, tick_s)
        self._manager = BatteryManager(self.bus, self.battery, spec.power, MASS_KG, tick_s)
        self._per_tick = 1.0 / tick_s

    def act(self) -> None:
        """Hear the bus, set the wheels."""
        self._controller.receive()
        self._controller.powered = not self.battery.is_empty
        self.body.drive(*self._controller.wheel_speeds_rad_s)

    def report(self) -> None:
        """Follow the body's motion and tell it on the bus."""
        body = self.body
        body.roll()
        self._controller.report(body.wheel_turns_rad)
        speed_m_s = math.hypot(body.forward_m, body.left_m) * self._per_tick
        self._manager.report(speed_m_s, body.turned_rad * self._per_tick)

    def scans_at(self, tick: int) -> bool:
        """Whether its lidar completes a turn with this tick."""
        return tick % self._scan_period_ticks == self._scan_phase


def _check_names(names: Sequence[str], what: str) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"expected each {what} once, got {', '.join(twice)} twice; give it another name")


def _check_starts(plan: FloorPlan, robots: Sequence[ArenaRobot]) -> None:
    for index, robot in enumerate(robots):
        start = robot.start
        clearance_m = _clearance_m(plan, start)
        if clearance_m < robot.radius_m:
            raise ValueError(
                f"expected {robot.name} to start at least its radius of {robot.radius_m:g} m from the walls of "
                f"{plan.name}, got {clearance_m:.3f} m at x {start.x_m:g}, y {start.y_m:g}"
            )
        for other in robots[:index]:
            if start.distance_m(other.start) < robot.radius_m + other.radius_m:
                raise ValueError(
                    f"expected {robot.name} to start clear of {other.name}, "
                    f"got {start.distance_m(other.start):.2f} m between them"
                )


def _clearance_m(plan: FloorPlan, pose: Pose2D) -> float:
    """Distance from a place to the nearest wall or edge of the plan; 0 inside one and beyond the other."""
    width_m, height_m = plan.size_m
    x_m, y_m = pose.x_m - plan.origin_x_m, pose.y_m - plan.origin_y_m
    to_edge_m = max(0.0, min(x_m, width_m - x_m, y_m, height_m - y_m))
    rows, columns = np.nonzero(plan.occupied)
    half_m = plan.resolution_m / 2
    beyond_x_m = np.maximum(np.abs((columns + 0.5) * plan.resolution_m - x_m) - half_m, 0.0)
    beyond_y_m = np.maximum(np.abs((rows + 0.5) * plan.resolution_m - y_m) - half_m, 0.0)
    return min(to_edge_m, float(np.hypot(beyond_x_m, beyond_y_m).min(initial=np.inf)))
