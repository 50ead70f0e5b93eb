"""A small floor with motes, a charger and robots whose behaviors are given tasks, for the tests of errands."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import TaskStatus
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer, TaskOffer, TaskWithdrawal
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.table.topics import COORDINATOR_STATE, ROBOT_CALL, ROBOT_OFFER, ROBOT_WITHDRAW
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.motes.mote import ArenaMote
from robrain.sim.robot.lidar import LidarSpec
from robrain.sim.world.arena import Arena, ArenaRobot
from robrain.sim.world.chargers import ChargerSpec
from robrain.sim.world.referee import team_geometry

Build = Callable[..., "Errands"]
TICK_NS = 20_000_000
TEAM = "errands"
SPEAKS_EVERY = 25
RESOLUTION_M = 0.05

BEHAVIORS = (
    "visit",
    "inspect",
    "collect",
    "relay",
    "monitor",
    "sense",
    "seek",
    "replace",
    "recharge",
    "wander",
    "idle",
)
PLACELESS = {"wander", "counter", "camera", "sensor_board", "home"}
"""Plugins that need no map."""
MOTES = {1: Point2D(4.5, 1.0), 2: Point2D(1.0, 3.2)}
CHARGER = Point2D(0.8, 0.8)
START = Pose2D(1.5, 1.5, 0.0)


def room() -> FloorPlan:
    """6 x 4 m with a pillar in the middle."""
    occupied = np.ones((80, 120), np.bool_)
    occupied[2:-2, 2:-2] = False
    occupied[38:44, 58:64] = True
    return FloorPlan(occupied, RESOLUTION_M, 0.0, 0.0, "room")


def open_errands(*always: str) -> Iterator[Build]:
    """For fixtures: builds rooms whose robots have these plugins and run, and closes them at the end."""
    opened: list[Errands] = []

    def build(*load: str, **options: Any) -> Errands:
        opened.append(Errands(*always, *load, **options))
        opened[-1].run(1.0)
        assert not opened[-1].why_not_running()
        return opened[-1]

    yield build
    for one in opened:
        one.close()


class Errands:
    """Robots in the room, in lockstep; a coordinator that says that it is there, and nothing more.

    Args:
        load: plugins of every robot, with what they require.
        starts: where further robots start, by name; r1 starts at START.
        seed: of everything random.
        parameters: of plugins, the same for all robots.
        hardware: of all robots, beside the defaults.
        docks: where the chargers stand.

    """

    def __init__(
        self,
        *load: str,
        starts: dict[str, Pose2D] | None = None,
        seed: int = 1,
        parameters: dict[str, dict[str, Any]] | None = None,
        hardware: dict[str, Any] | None = None,
        docks: tuple[Point2D, ...] = (CHARGER,),
    ) -> None:
        self.session = open_lockstep_session()
        self.clock = VirtualClock()
        self.wire = Endpoint(self.session, TEAM, self.clock, Drive.LOCKSTEP)
        self.plan = room()
        self.answers: dict[str, TaskAnswer] = {}
        self._ticks = self._epoch = 0
        poses = {"r1": START, **(starts or {})}
        built = {"lidar": LidarSpec(noise_m=0.0), **(hardware or {})}
        robots = [ArenaRobot(name=name, start=start, **built) for name, start in poses.items()]
        motes = [ArenaMote(name=f"m{number}", number=number, place=place) for number, place in MOTES.items()]
        chargers = tuple(ChargerSpec(place_m=(dock.x_m, dock.y_m)) for dock in docks)
        rng = np.random.default_rng([seed, 1])
        self.arena = Arena(self.plan, robots, motes, self.wire, rng, chargers=chargers)
        self.hosts = {name: self._host(name, pose, list(load), seed, parameters or {}) for name, pose in poses.items()}
        self._speaks = self.wire.publisher(COORDINATOR_STATE)

    def _host(
        self, name: str, pose: Pose2D, load: list[str], seed: int, parameters: dict[str, dict[str, Any]]
    ) -> AgentHost:
        grid = team_geometry(self.plan)
        known: dict[str, dict[str, Any]] = {
            "localisation": {"x_m": pose.x_m, "y_m": pose.y_m, "yaw_rad": pose.yaw_rad},
            "mapper": {
                "resolution_m": grid.resolution_m,
                "origin_x_m": grid.origin_x_m,
                "origin_y_m": grid.origin_y_m,
                "width_m": grid.width * grid.resolution_m,
                "height_m": grid.height * grid.resolution_m,
            },
        }
        if not set(load) - PLACELESS:
            known = {}
        for plugin, values in parameters.items():
            known[plugin] = known.get(plugin, {}) | values
        robot_file = RobotFile(robot=RobotTable(name, TEAM, load=load), parameters=known)
        host = AgentHost(robot_file, Path(), self.session, self.clock, Drive.LOCKSTEP, seed=seed)
        host.start()
        return host

    def run(self, seconds: float) -> None:
        """Let that much time pass."""
        for _ in range(round(to_ns(seconds) / TICK_NS)):
            self._ticks += 1
            self.clock.advance_to(self._ticks * TICK_NS)
            self.arena.step()
            for host in self.hosts.values():
                host.step()
            if self._ticks % SPEAKS_EVERY == 1:
                self._speaks.put(TeamState(robots=[]))

    def offer(self, task: Task, robot: str = "r1", *, after: str = "") -> TaskAnswer:
        """Offer a task as the coordinator does, for now or for after the one that the robot is at."""
        self._epoch += 1
        offer = TaskOffer(task=task, epoch=self._epoch, lease_s=5.0, after=after)
        return self.wire.ask(ROBOT_OFFER, offer, robot=robot)

    def withdraw(self, task: str, robot: str = "r1") -> TaskAnswer:
        """Take a task back as the coordinator does."""
        withdrawal = TaskWithdrawal(id=task, epoch=self._epoch, why="changed our minds")
        return self.wire.ask(ROBOT_WITHDRAW, withdrawal, robot=robot)

    def status(self, robot: str = "r1") -> TaskStatus:
        """How the robot stands to its last task."""
        status = self.hosts[robot].desk.status
        assert status is not None
        return status

    def finish(self, task: Task, limit_s: float = 120.0, robot: str = "r1") -> TaskStatus:
        """Offer a task and let time pass until it has ended."""
        answer = self.offer(task, robot)
        assert answer.accepted, answer.why
        for _ in range(round(limit_s / 0.2)):
            if self.status(robot).state.ended:
                break
            self.run(0.2)
        assert self.status(robot).state.ended, f"{task.id} has not ended after {limit_s} s"
        return self.status(robot)

    def call(self, plugin: str, function: str, *arguments: Any, robot: str = "r1") -> Any:
        """An external call."""
        reply = self.wire.ask(ROBOT_CALL, list(arguments), robot=robot, plugin=plugin, function=function)
        return msgspec.json.decode(reply)

    def inbox(self, topic: Any, **names: str) -> Inbox:
        """What is said on a topic from now on."""
        inbox = Inbox(100_000, every=True)
        self.wire.subscribe(inbox, topic, **names)
        return inbox

    def pose(self, robot: str = "r1") -> Pose2D:
        """Where a robot really is."""
        return next(truth.pose for truth in self.arena.truth.robots if truth.robot == robot)

    def way_m(self, robot: str = "r1") -> float:
        """How far it really has gone."""
        return next(truth.distance_m for truth in self.arena.truth.robots if truth.robot == robot)

    def is_cut_off(self, robot: str = "r1") -> bool:
        """Whether a robot's battery has given its last."""
        return self.arena._named(robot).battery.is_cut_off

    def why_not_running(self) -> dict[str, str]:
        """Plugins of r1 that do not run, and why."""
        tags = self.hosts["r1"].manager.plugins.values()
        return {tag.name: tag.why for tag in tags if tag.state != "active"}

    def close(self) -> None:
        """End it."""
        for host in self.hosts.values():
            host.close()
        self.arena.close()
        self.wire.close()
        self.session.close()
