from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import zenoh

from robrain.agent.authoring.testing import HostBench
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.algorithms.warm_up import warm_up
from robrain.protocol.can.frames import codec
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.clock import to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer, TaskOffer
from robrain.protocol.messages.team.arena_messages import Scan
from robrain.protocol.messages.team.team_messages import Halt, TeamState
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.table.topic import Topic
from robrain.protocol.table.topics import ARENA_RADIO_RX, ARENA_SCAN, COORDINATOR_STATE, HALT, ROBOT_OFFER, ROBOT_STATE
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.robot.lidar import LidarSpec
from robrain.sim.world.arena import Arena, ArenaRobot
from robrain.sim.world.referee import team_geometry

TICK_NS = 20_000_000
RESOLUTION_M = 0.05
TEAM = "test"
COORDINATOR_PERIOD_TICKS = 25


class Stage(HostBench):
    """Robots' hosts in lockstep; with a floor plan the robots also have bodies in an arena."""

    def __init__(self, session: zenoh.Session, plan: FloorPlan | None = None, **starts: Pose2D) -> None:
        super().__init__(session, TEAM)
        self.plan = plan
        self.coordinator_speaks = False
        self.arena: Arena | None = None
        self._starts = starts
        self._ticks = 0
        self._buses: list[ZenohBus] = []
        self._controllers: dict[str, ZenohBus] = {}
        self._publishers: dict[str, Any] = {}
        if plan is not None:
            robots = [
                ArenaRobot(name=name, start=start, lidar=LidarSpec(noise_m=0.0)) for name, start in starts.items()
            ]
            self.arena = Arena(plan, robots, [], self.wire, np.random.default_rng(1))

    def host(self, *load: str, robot: str = "r1", start: bool = True, **parameters: dict[str, Any]) -> AgentHost:
        """A robot's host with these plugins and what they require; it knows where its body stands."""
        if self.plan is not None:
            pose, grid = self._starts[robot], team_geometry(self.plan)
            known = {
                "localisation": {"x_m": pose.x_m, "y_m": pose.y_m, "yaw_rad": pose.yaw_rad},
                "mapper": {
                    "resolution_m": grid.resolution_m,
                    "origin_x_m": grid.origin_x_m,
                    "origin_y_m": grid.origin_y_m,
                    "width_m": grid.width * grid.resolution_m,
                    "height_m": grid.height * grid.resolution_m,
                },
            }
            parameters = {name: known[name] for name in known if {name, "explore"} & set(load)} | parameters
        robot_file = RobotFile(robot=RobotTable(robot, TEAM, load=list(load)), parameters=parameters)
        host = self.add(robot_file)
        if start:
            host.start()
        return host

    def bus(self, robot: str = "r1") -> ZenohBus:
        """Another node on a robot's CAN bus."""
        bus = ZenohBus(f"{robot}/can0", session=self.session, team=TEAM, direct=True, now_ns=self.clock.now_ns)
        self._buses.append(bus)
        return bus

    def inbox(self, topic: Topic, **names: str) -> Inbox:
        """What is said on a topic, every message of it."""
        inbox = Inbox(100_000, every=True)
        self.wire.subscribe(inbox, topic, **names)
        return inbox

    def run(self, duration_s: float, each: Callable[[], None] | None = None) -> None:
        """Ticks; `each` is called in every one, after the arena's step and before the robots'."""
        for _ in range(round(to_ns(duration_s) / TICK_NS)):
            self._ticks += 1
            self.clock.advance_to(self._ticks * TICK_NS)
            if self.arena is not None:
                self.arena.step()
            if self.coordinator_speaks and self._ticks % COORDINATOR_PERIOD_TICKS == 1:
                self.publisher(COORDINATOR_STATE).put(TeamState(robots=[]))
            if each is not None:
                each()
            for host in self.hosts:
                host.step()

    def run_until(self, is_so: Callable[[], bool], limit_s: float) -> float:
        """Ticks until it is so; returns how long that took."""
        for tick in range(round(to_ns(limit_s) / TICK_NS)):
            if is_so():
                return tick * TICK_NS / 1e9
            self.run(TICK_NS / 1e9)
        assert is_so(), f"not so after {limit_s} s"
        return limit_s

    def publisher(self, topic: Topic, **names: str) -> Any:
        key = topic.key(TEAM, **names)
        if key not in self._publishers:
            self._publishers[key] = self.wire.publisher(topic, **names)
        return self._publishers[key]

    # -- what the world says to a robot -----------------------------------------------------------------------

    def scan(self, ranges_m: list[float], *, robot: str = "r1", range_max_m: float = 6.0) -> None:
        """One turn of the lidar, evenly over the circle from −π; 0 is no return."""
        self.publisher(ARENA_SCAN, robot=robot).put(
            Scan(
                robot=robot,
                angle_min_rad=-np.pi,
                angle_increment_rad=2 * np.pi / len(ranges_m),
                range_max_m=range_max_m,
                ranges_mm=[round(1000 * range_m) for range_m in ranges_m],
            )
        )

    def stand_and_scan(self, ranges_m: list[float], *, robot: str = "r1", range_max_m: float = 6.0) -> None:
        """As `scan`, of a robot whose wheels say that it stands: what it sees is mapped once that is known."""
        if robot not in self._controllers:
            self._controllers[robot] = self.bus(robot)
        standing = {f"wheel_{wheel}_ticks": 0 for wheel in (1, 2, 3)}
        self._controllers[robot].send(codec("WheelEncoders").pack(0, **standing))
        self.scan(ranges_m, robot=robot, range_max_m=range_max_m)

    def radio(self, packet: bytes, *, robot: str = "r1") -> None:
        self.publisher(ARENA_RADIO_RX, robot=robot).put_bytes(packet)

    def say_state(self, name: str, pose: Pose2D | None, *, radius_m: float = 0.2) -> None:
        """The state of a robot that has no host here."""
        self.publisher(ROBOT_STATE, robot=name).put(RobotState(robot=name, pose=pose, radius_m=radius_m))

    def halt(self, *, halted: bool = True) -> None:
        self.publisher(HALT).put(Halt(halted=halted, by="test"))

    # -- asking a robot ---------------------------------------------------------------------------------------

    def offer(
        self, goal: Point2D, *, task: str = "t1", epoch: int = 1, lease_s: float = 60.0, robot: str = "r1"
    ) -> TaskAnswer:
        offer = TaskOffer(task=Task(id=task, kind="explore", place=goal), epoch=epoch, lease_s=lease_s)
        return self.wire.ask(ROBOT_OFFER, offer, robot=robot)

    # -- the truth --------------------------------------------------------------------------------------------

    def truth(self, robot: str = "r1") -> Any:
        return next(truth for truth in self.arena.truth.robots if truth.robot == robot)

    def close(self) -> None:
        for host in self.hosts:
            host.close()
        if self.arena is not None:
            self.arena.close()
        for bus in self._buses:
            bus.shutdown()
        self.wire.close()


@pytest.fixture(scope="session", autouse=True)
def _kernels() -> None:
    warm_up()


@pytest.fixture(scope="session")
def session() -> Iterator[zenoh.Session]:
    with open_lockstep_session() as session:
        yield session


@pytest.fixture
def stage(session: zenoh.Session) -> Iterator[Callable[..., Stage]]:
    opened: list[Stage] = []

    def build(plan: FloorPlan | None = None, **starts: Pose2D) -> Stage:
        opened.append(Stage(session, plan, **starts))
        return opened[-1]

    yield build
    for one in reversed(opened):
        one.close()


@pytest.fixture
def frames() -> Callable[[ZenohBus, str], list[dict[str, float]]]:
    """Takes what has arrived at a node and decodes the frames of one name."""

    def take(bus: ZenohBus, name: str) -> list[dict[str, float]]:
        arrived = list(iter(lambda: bus.recv(timeout=0), None))
        return [codec(name).unpack(frame) for frame in arrived if frame.arbitration_id == codec(name).arbitration_id]

    return take


@pytest.fixture(scope="session")
def room() -> Callable[..., FloorPlan]:
    """Makes a room with walls 0.1 m thick; `blocks` (x0, y0, x1, y1), metres, are solid too."""

    def build(width_m: float = 4.0, height_m: float = 4.0, *blocks: tuple[float, float, float, float]) -> FloorPlan:
        occupied = np.ones((round(height_m / RESOLUTION_M), round(width_m / RESOLUTION_M)), np.bool_)
        occupied[2:-2, 2:-2] = False
        for block in blocks:
            x0, y0, x1, y1 = (round(edge_m / RESOLUTION_M) for edge_m in block)
            occupied[y0:y1, x0:x1] = True
        return FloorPlan(occupied, RESOLUTION_M, 0.0, 0.0, "room")

    return build
