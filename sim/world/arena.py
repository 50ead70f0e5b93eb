"""The arena: one tick of a simulated world after another, the same in lockstep and in live.

Robots are driven only by frames on their CAN buses. The arena counts ticks; its owner calls `step()` once a tick and
advances the clock that stamps messages.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import msgspec
import numpy as np

from robrain.algorithms.navigation.clearance import least_clearance_m
from robrain.client.door_keeper import DoorKeeper
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.team import arena_messages
from robrain.protocol.messages.team.arena_messages import ArenaClock, ArenaTruth, MoteTruth, RobotTruth
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.tinyos.packet import ActiveMessage
from robrain.protocol.tinyos.payloads import Quantity
from robrain.protocol.wire.endpoint import Endpoint, Request
from robrain.sim.faults.fault_spec import FaultKind, FaultSpec, FaultTimes
from robrain.sim.firmware.battery import STATUS_PERIOD_S
from robrain.sim.firmware.disturbance import Disturbance
from robrain.sim.maps.surfaces import FloorSurfaces
from robrain.sim.motes.field import SimulatedField
from robrain.sim.motes.gateway import MoteGateway, gateway_motes
from robrain.sim.motes.motes import MoteField
from robrain.sim.points.point_team import PointFloor, PointRobot, PointTeam
from robrain.sim.robot.camera import Camera, SeenMote, SeenRobot
from robrain.sim.robot.robot_body import Body
from robrain.sim.robot.robot_team import RobotTeam
from robrain.sim.robot.simulated_robot import SimulatedRobot
from robrain.sim.world.chargers import Chargers
from robrain.sim.world.referee import TRUE_POSE_PERIOD_S, AccuracyMeter, Referee, team_geometry
from robrain.sim.world.scenario_tasks import TaskSchedule
from robrain.sim.world.world import Fidelity, World

FLOOD_PACKETS_A_TICK = 40
"""2,000 a second at 50 ticks; a Mica2's radio brings some 40."""
FLOOD_TYPE = 0xEE


class FaultSchedule:
    """Breaks and mends, tick by tick.

    Args:
        faults: of hardware, at set times.
        robots: their robots, by name.
        endpoint: floods are put there.

    """

    def __init__(
        self, faults: Sequence[FaultSpec], robots: Mapping[str, SimulatedRobot | PointRobot], endpoint: Endpoint
    ) -> None:
        self._robots = robots
        self._endpoint = endpoint
        self._times = FaultTimes(faults, seed=0)
        self._floods: dict[str, Any] = {}
        """By robot: where its mote base is flooded at present."""
        self.is_on = bool(faults)
        """Whether `step` must be called."""
        self._noise = ActiveMessage(type=FLOOD_TYPE, payload=bytes(16), source=0).pack()

    def step(self, now_ns: int) -> None:
        """Begin and end the faults that are due, and flood."""
        for _, fault, breaks in self._times.due(now_ns):
            self.set(fault, breaks=breaks)
        for radio in self._floods.values():
            for _ in range(FLOOD_PACKETS_A_TICK):
                radio.put_bytes(self._noise)

    def set(self, fault: FaultSpec, *, breaks: bool) -> None:
        """Apply a fault now, or repair it."""
        name = fault.robot
        if fault.kind is not FaultKind.MOTE_BASE_FLOODS:
            self._robots[name].set_fault(fault, breaks=breaks)
        elif breaks:
            self._floods[name] = self._endpoint.publisher(arena_messages.ARENA_RADIO_RX, robot=name)
            self.is_on = True
        else:
            del self._floods[name]


CLOCK_PERIOD_S = 0.1
TRUTH_PERIOD_S = 0.2


class Arena:
    """Walls, robots and motes, advanced tick by tick.

    Randomness is spawned by place: robots, motes and links keep theirs when others are added after them.

    Args:
        world: the floor with all that is put on it; each robot starts clear of walls and of the others.
        endpoint: publishes all messages of the arena; its owner closes it after the arena.
        gateway_wire: opens the endpoint of a gateway of this name, which its owner closes; None for the arena's own.
        rng: source of all randomness; that of the world's seed if None.

    """

    def __init__(
        self,
        world: World,
        endpoint: Endpoint,
        gateway_wire: Callable[[str], Endpoint] | None = None,
        rng: np.random.Generator | None = None,
    ) -> None:
        plan, robots, motes, network = world.plan, world.robots, world.motes, world.network
        tick_s = world.tick_s
        names = [robot.name for robot in robots]
        rng = world.arena_rng() if rng is None else rng
        robots_rng, motes_rng, field_rng = rng.spawn(3)

        self.tick_s = tick_s
        self._ticks = 0
        walls, true_walls = plan.occupied.copy(), plan.occupied.copy()
        geometry = plan.geometry
        self._team: RobotTeam | PointTeam
        if world.fidelity is Fidelity.POINTS:
            self._team = PointTeam(robots, PointFloor(true_walls, geometry), tick_s)
            self._bodies: Sequence[Body] = self._team.robots
        else:
            self._team = RobotTeam(
                plan,
                walls,
                geometry,
                robots,
                endpoint,
                robots_rng,
                tick_s,
                None if world.surfaces.is_plain else FloorSurfaces.draw(world.surfaces, plan, world.seed),
                Disturbance(world.disturbance, world.seed),
                world.traffic,
            )
            self._bodies = self._team.bodies.bodies
        self._robots: Sequence[SimulatedRobot | PointRobot] = self._team.robots
        self.chargers = Chargers(world.chargers, tick_s)
        self._charger_period_ticks = max(1, round(STATUS_PERIOD_S / tick_s))

        field = SimulatedField.draw(network.field, plan, field_rng)
        fixed = gateway_motes(motes, network.motes.gateways)
        self._motes = MoteField(motes, names, network, field, endpoint, motes_rng, tick_s, fixed)
        self.gateways = [
            MoteGateway(
                mote.name,
                endpoint if gateway_wire is None else gateway_wire(mote.name),
                network.motes.gateway_readings,
            )
            for mote in fixed
        ]
        """Those beside motes."""
        docks = [Point2D(*charger.place_m) for charger in world.chargers]
        seeds = rng.spawn(1)[0].integers(1 << 32, size=len(names)).tolist()
        self._cameras = [
            Camera(robot.camera, walls, geometry, seed, docks) for robot, seed in zip(robots, seeds, strict=True)
        ]
        self._sensor_seeds = rng.spawn(1)[0].integers(1 << 32, size=len(names)).tolist()
        self._field = field
        self._index = {name: index for index, name in enumerate(names)}
        self._seen_motes = [SeenMote(mote.number, mote.place) for mote in motes]
        for name in names:
            endpoint.answer(arena_messages.ARENA_CAMERA, self._answer_picture, robot=name)
        for name in names:
            endpoint.answer(arena_messages.ARENA_SENSE, self._answer_measurement, robot=name)
        self._mote_truths = [MoteTruth(mote=mote.name, place=mote.place) for mote in motes]
        starts = [Point2D(robot.start.x_m, robot.start.y_m) for robot in robots]
        radius_m = min((robot.radius_m for robot in robots), default=0.0)
        self.referee = Referee(plan, starts, least_clearance_m(radius_m), team_geometry(plan), endpoint)
        self.accuracy = AccuracyMeter(names, self._bodies, self.referee, true_walls, geometry, endpoint)
        faults = [fault for fault in world.faults if fault.is_plain]
        self._faults = FaultSchedule(faults, {robot.name: robot for robot in self._robots}, endpoint)
        self.tasks = TaskSchedule(world.tasks, endpoint)
        self._doors = [
            DoorKeeper(spec.name, door, endpoint, opening_s=spec.opening_s or 0.0)
            for door, spec in (self._team.traffic.doors_on_request if self._team.traffic is not None else ())
        ]
        self._added = [table.build(world, endpoint) for table in world.added]
        self._clock_publisher = endpoint.publisher(arena_messages.ARENA_CLOCK)
        self._truth_publisher = endpoint.publisher(arena_messages.ARENA_TRUTH)
        self._clock_period_ticks = max(1, round(CLOCK_PERIOD_S / tick_s))
        self._truth_period_ticks = max(1, round(TRUTH_PERIOD_S / tick_s))
        self._true_pose_period_ticks = max(1, round(TRUE_POSE_PERIOD_S / tick_s))

    @property
    def sim_time_s(self) -> float:
        """Time simulated so far: ticks times `tick_s`."""
        return self._ticks * self.tick_s

    @property
    def collisions(self) -> int:
        """Sum of all robots' collisions; two that meet count one each."""
        return sum(self._team.collisions)

    @property
    def bodies(self) -> Sequence[Body]:
        """The robots' bodies, in their order, as of the last tick."""
        return self._bodies

    @property
    def truth(self) -> ArenaTruth:
        """The world as it is now."""
        return ArenaTruth(
            sim_time_s=self.sim_time_s,
            robots=[
                RobotTruth(
                    robot=robot.name,
                    pose=body.pose,
                    collisions=collisions,
                    distance_m=body.distance_m,
                    energy_j=robot.delivered_j,
                    accuracy=self.accuracy.pose_accuracy(robot.name),
                )
                for robot, body, collisions in zip(self._robots, self._bodies, self._team.collisions, strict=True)
            ],
            motes=self._mote_truths,
            explored_fraction=self.referee.explored_fraction,
            map_accuracy=self.accuracy.map_accuracy,
            bodies=msgspec.UNSET if self._team.traffic is None else self._team.traffic.truth(),
        )

    def step(self) -> None:
        """One tick: firmware reads its bus, bodies move, firmware and sensors send."""
        if self._faults.is_on:
            self._faults.step(to_ns(self.sim_time_s))
        tick = self._ticks + 1
        self._team.move(tick)
        self._ticks = tick
        self._charge()
        self._team.report(tick)
        self._motes.step(self._bodies)
        for gateway in self.gateways:
            gateway.step()
        if self.tasks.is_on:
            self.tasks.step(self.sim_time_s)
        for keeper in self._doors:
            keeper.step()
        for step in self._added:
            step(to_ns(self.sim_time_s))
        if self._ticks % self._clock_period_ticks == 0:
            self._clock_publisher.put(ArenaClock(sim_time_s=self.sim_time_s))
        if self._ticks % self._true_pose_period_ticks == 0:
            self.accuracy.keep()
        if self._ticks % self._truth_period_ticks == 0:
            self.referee.step()
            self.accuracy.step()
            self._truth_publisher.put(self.truth)

    def set_fault(self, fault: FaultSpec, *, breaks: bool) -> None:
        """Break a robot's hardware now, or mend it; drain its battery."""
        self._faults.set(fault, breaks=breaks)

    def robot(self, name: str) -> SimulatedRobot | PointRobot:
        """A robot (KeyError: there is none of that name)."""
        return {each.name: each for each in self._robots}[name]

    @contextmanager
    def unplugged(self, robot: str) -> Iterator[None]:
        """Frames that a robot's computer sends within the block reach none of its nodes (KeyError: no such robot)."""
        try:
            yield
        finally:
            self.robot(robot).drop_commands()

    def picture(self, robot: str) -> bytes:
        """A PNG of a robot's current view (KeyError: no such robot)."""
        own = self._index[robot]
        others = [SeenRobot(index, body.pose, body.radius_m) for index, body in enumerate(self._bodies) if index != own]
        return self._cameras[own].png(self._bodies[own].pose, others, self._seen_motes, self._ticks)

    def measurement(self, robot: str) -> dict[str, float]:
        """Measurement of a robot's board now, by the wire's names, with the noise of a mote (KeyError: no such robot).

        As with pictures, the noise comes from the time and the robot alone: queries do not change it.
        """
        own, field = self._index[robot], self._field
        body = self._bodies[own]
        place = Point2D(body.x_m, body.y_m)
        noise = np.random.default_rng([self._sensor_seeds[own], self._ticks]).standard_normal(len(Quantity)).tolist()
        return {
            quantity.wire_name: round(
                field.value(quantity, place, self.sim_time_s) + field.spec.levels(quantity).noise * one, 3
            )
            for quantity, one in zip(Quantity, noise, strict=True)
        }

    def _answer_picture(self, request: Request[Any]) -> bytes:
        return self.picture(request.names["robot"])

    def _answer_measurement(self, request: Request[Any]) -> dict[str, float]:
        return self.measurement(request.names["robot"])

    def close(self) -> None:
        """Leave the robots' buses."""
        self._team.close()

    def _charge(self) -> None:
        if self.chargers.docked and self._ticks % self._charger_period_ticks == 0:
            supplies_w = self.chargers.supplies_w(self._bodies)
            for robot, supply_w in zip(self._robots, supplies_w, strict=True):
                robot.supply(supply_w)
