"""A floor that all robots know, with couriers on it that meet."""

import math
from collections.abc import Callable

import numpy as np
import zenoh

from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.lab.bench.traffic import COURIER
from robrain.plugins.behavior.travel import TravelState
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.robot.lidar import LidarSpec
from robrain.sim.robot.robot_hardware import ArenaRobot
from robrain.sim.world.arena import Arena
from robrain.sim.world.world import TICK_S, World
from tests.plugins.arena_bench import ArenaBench, start_parameters

WATCHED_S = 0.2
TEAM = "crossing"


class Crossing(ArenaBench):
    """Arena and hosts in lockstep. Each robot, r1, r2 …, has a start and a goal.

    Args:
        session: shared by all.
        plan: the floor, known to all robots from the beginning.
        ways: start and goal of each.
        silent: robots that stand there without a host: nobody hears of them.
        lidar: of all robots.
        seed: of the arena's randomness.

    """

    def __init__(
        self,
        session: zenoh.Session,
        plan: FloorPlan,
        ways: list[tuple[Point2D, Point2D]],
        silent: tuple[Point2D, ...] = (),
        lidar: LidarSpec = LidarSpec(),  # noqa: B008 - frozen
        seed: int = 1,
    ) -> None:
        super().__init__(session, TEAM)
        self.goals = {f"r{number}": goal for number, (_, goal) in enumerate(ways, 1)}
        starts = {
            f"r{number}": Pose2D(start.x_m, start.y_m, math.atan2(goal.y_m - start.y_m, goal.x_m - start.x_m))
            for number, (start, goal) in enumerate(ways, 1)
        }
        robots = [ArenaRobot(name=name, start=start, lidar=lidar) for name, start in starts.items()]
        robots += [
            ArenaRobot(name=f"s{number}", start=Pose2D(place.x_m, place.y_m, 0.0))
            for number, place in enumerate(silent, 1)
        ]
        self.arena = Arena(World(plan, robots, [], seed), self.wire, rng=np.random.default_rng(seed))
        cells = np.where(plan.occupied, 100, 0).astype(np.int8)
        for name, start in starts.items():
            table = RobotTable(name, TEAM, places=[str(COURIER)], load=["courier"])
            self.add(RobotFile(robot=table, parameters=start_parameters(plan, start))).start()
            # As a submap of somebody who has been there before.
            self.plugin("mapper", name)._atlas.merge(("known", 1), 0, 0, cells, 1)
        self.arrived_s: dict[str, float] = {}
        self.deadlock_s = 0.0
        """The longest time for which nobody that was under way moved."""
        self.nearest_m = math.inf
        """The least distance of two hulls."""
        self._moved_s = 0.0

    def go(self, *names: str, priority: int = 0) -> None:
        """Send robots to their goals; all of them if none is named."""
        for name in names or self.goals:
            goal = self.goals[name]
            assert self.courier(name).go(goal.x_m, goal.y_m, priority)

    def courier(self, name: str):
        """The behavior of a robot."""
        return self.plugin("courier", name)

    def run(self, duration_s: float, each: Callable[[], None] | None = None) -> None:
        """Let time pass and watch the robots."""
        for _ in range(round(duration_s / WATCHED_S)):
            super().run(WATCHED_S, each)
            self._watch()

    def run_until_all_arrived(self, limit_s: float, *names: str) -> float:
        """Let time pass until these, or all, are there; how long that took, or the limit."""
        begun = self._ticks
        while (self._ticks - begun) * TICK_S < limit_s:
            self.run(0.2)
            if set(names or self.goals) <= set(self.arrived_s):
                break
        return (self._ticks - begun) * TICK_S

    @property
    def collisions(self) -> int:
        return self.arena.collisions

    def _watch(self) -> None:
        now_s = self._ticks * TICK_S
        truths = self.arena.truth.robots
        for index, truth in enumerate(truths):
            for other in truths[:index]:
                self.nearest_m = min(self.nearest_m, truth.pose.distance_m(other.pose) - 0.4)
        under_way = []
        for name in self.goals:
            courier = self.courier(name)
            if courier.state is TravelState.ARRIVED and self.pose(name).distance_m(self.goals[name]) < 0.5:
                self.arrived_s.setdefault(name, now_s)
            elif courier.state in (TravelState.MOVING, TravelState.WAITING):
                under_way.append(name)
        moved = any(
            abs(host.board.velocity.forward_m_s) + abs(host.board.velocity.left_m_s) > 0.05 for host in self.hosts
        )
        if moved or not under_way:
            self._moved_s = now_s
        self.deadlock_s = max(self.deadlock_s, now_s - self._moved_s)
