from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import zenoh

from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.algorithms.warm_up import warm_up
from robrain.protocol.can.frames import codec
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.messages.tasks.offer_messages import ROBOT_OFFER, TaskAnswer, TaskOffer
from robrain.protocol.messages.team.arena_messages import ARENA_RADIO_RX, ARENA_SCAN, Scan
from robrain.protocol.messages.team.team_messages import HALT, Halt
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.robot.lidar import LidarSpec
from robrain.sim.robot.robot_hardware import ArenaRobot
from robrain.sim.world.arena import Arena
from robrain.sim.world.world import World
from tests.plugins.arena_bench import ArenaBench, start_parameters

RESOLUTION_M = 0.05
TEAM = "test"


class Stage(ArenaBench):
    """Robots' hosts in lockstep; with a floor plan the robots also have bodies in an arena."""

    def __init__(self, session: zenoh.Session, plan: FloorPlan | None = None, **starts: Pose2D) -> None:
        super().__init__(session, TEAM)
        self.plan = plan
        self._starts = starts
        self._buses: list[ZenohBus] = []
        self._controllers: dict[str, ZenohBus] = {}
        if plan is not None:
            robots = [
                ArenaRobot(name=name, start=start, lidar=LidarSpec(noise_m=0.0)) for name, start in starts.items()
            ]
            self.arena = Arena(World(plan, robots, [], 1), self.wire, rng=np.random.default_rng(1))

    def host(self, *load: str, robot: str = "r1", start: bool = True, **parameters: dict[str, Any]) -> AgentHost:
        """A robot's host with these plugins and what they require; it knows where its body stands."""
        if self.plan is not None:
            known = start_parameters(self.plan, self._starts[robot])
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

    def close(self) -> None:
        super().close()
        for bus in self._buses:
            bus.shutdown()


@pytest.fixture(scope="session", autouse=True)
def _kernels() -> None:
    warm_up()


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
