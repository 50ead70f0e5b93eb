"""A small floor with motes, a charger and robots whose behaviors are given tasks, for the tests of errands."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.protocol.messages.robots.robot_messages import TaskStatus
from robrain.protocol.messages.tasks import offer_messages
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer, TaskOffer, TaskWithdrawal
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.motes.mote import ArenaMote
from robrain.sim.robot.lidar import LidarSpec
from robrain.sim.robot.robot_hardware import ArenaRobot
from robrain.sim.world.arena import Arena
from robrain.sim.world.chargers import ChargerSpec
from robrain.sim.world.world import World
from tests.plugins.arena_bench import ArenaBench, start_parameters

Build = Callable[..., "Errands"]
TEAM = "errands"
RESOLUTION_M = 0.05

BEHAVIORS = (
    "visit",
    "inspect",
    "collect",
    "relay",
    "monitor",
    "patrol",
    "deliver",
    "sweep",
    "follow",
    "guard",
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

    try:
        yield build
    finally:
        for one in opened:
            one.close()


class Errands(ArenaBench):
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
        super().__init__(open_lockstep_session(), TEAM, coordinator_speaks=True)
        self._epoch = 0
        plan = room()
        poses = {"r1": START, **(starts or {})}
        built = {"lidar": LidarSpec(noise_m=0.0), **(hardware or {})}
        robots = [ArenaRobot(name=name, start=start, **built) for name, start in poses.items()]
        motes = [ArenaMote(name=f"m{number}", number=number, place=place) for number, place in MOTES.items()]
        chargers = tuple(ChargerSpec(place_m=(dock.x_m, dock.y_m)) for dock in docks)
        self.arena = Arena(World(plan, robots, motes, seed, chargers=chargers), self.wire)
        for name, pose in poses.items():
            known = start_parameters(plan, pose) if set(load) - PLACELESS else {}
            for plugin, values in (parameters or {}).items():
                known[plugin] = known.get(plugin, {}) | values
            self.add(RobotFile(robot=RobotTable(name, TEAM, load=list(load)), parameters=known), seed=seed).start()

    def offer(self, task: Task, robot: str = "r1", *, after: str = "") -> TaskAnswer:
        """Offer a task as the coordinator does, for now or for after the one that the robot is at."""
        self._epoch += 1
        offer = TaskOffer(task=task, epoch=self._epoch, lease_s=5.0, after=after)
        return self.wire.ask(offer_messages.ROBOT_OFFER, offer, robot=robot)

    def withdraw(self, task: str, robot: str = "r1") -> TaskAnswer:
        """Take a task back as the coordinator does."""
        withdrawal = TaskWithdrawal(id=task, epoch=self._epoch, why="changed our minds")
        return self.wire.ask(offer_messages.ROBOT_WITHDRAW, withdrawal, robot=robot)

    def status(self, robot: str = "r1") -> TaskStatus:
        """How the robot stands to its last task."""
        status = self.robot(robot).desk.status
        assert status is not None
        return status

    def finish(self, task: Task, limit_s: float = 120.0, robot: str = "r1") -> TaskStatus:
        """Offer a task and let time pass until it has ended."""
        answer = self.offer(task, robot)
        assert answer.accepted, answer.why
        self.run_until(lambda: self.status(robot).state.ended, limit_s, 0.2)
        return self.status(robot)

    def path_m(self, robot: str = "r1") -> float:
        """How far it really has gone."""
        return self.truth(robot).distance_m

    def is_cut_off(self, robot: str = "r1") -> bool:
        """Whether a robot's battery has given its last."""
        return self.arena.robot(robot).battery.is_cut_off

    def why_not_running(self) -> dict[str, str]:
        """Plugins of r1 that do not run, and why."""
        tags = self.robot().manager.plugins.values()
        return {tag.name: tag.state_reason for tag in tags if tag.state != "active"}

    def close(self) -> None:
        """End it."""
        super().close()
        self.session.close()
