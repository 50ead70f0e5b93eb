"""One exploration whose coordinator is killed on the way, or that is left undisturbed."""

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.deploy.bench.mapping.mapping_plan import errors_alone
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.navigation.clearance import least_clearance_m
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.maps.placement import Starts
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.referee import floor_weights

KNOWN = 0.95
"""Share of the floor at which a run ends."""
KILLED_AT = 0.3
"""Share of the floor that is known when the coordinator is killed."""
LOOK_S = 1.0
"""Period in which each robot's own map is looked at."""


class LeaderlessCase(msgspec.Struct, frozen=True, kw_only=True):
    """One run."""

    map: str
    path: str = ""
    """Path of the map's YAML file; empty for a built-in scenario."""
    robots: int
    seed: int
    consensus: bool = True
    """Whether robots may go on without a coordinator."""
    killed_at: float | None = KILLED_AT
    """Share of the floor that is known when the coordinator is killed; None leaves it alone."""
    time_limit_s: float = 900.0

    def scenario(self) -> Scenario:
        """The scenario of the run (RobrainError if the map cannot be read)."""
        found = Scenario.from_map(self.path) if self.path else Scenario.builtin(self.map)
        hardware = msgspec.structs.replace(found.hardware, consensus=self.consensus)
        return found.replace(
            robots=self.robots, seed=self.seed, starts=Starts.TOGETHER, motes=0, hardware=hardware, tasks=()
        )


class LeaderlessRun(msgspec.Struct, frozen=True, kw_only=True):
    """What a run took."""

    case: LeaderlessCase
    team_s: float
    """When all robots together knew 95 % of the floor, in simulated seconds; inf if they never did."""
    last_s: float
    """When each of them did by its own map."""
    killed_s: float = math.inf
    known: float = 0.0
    """Share of the floor that was known in the end."""
    collisions: int = 0


def run_case(case: LeaderlessCase) -> LeaderlessRun:
    """Explore until every robot knows 95 % of the floor by its own map, or time is up."""
    scenario = case.scenario()
    with errors_alone():
        run = LockstepRun(scenario.world(), planning=scenario.planning)
        try:
            return _explore(run, case)
        finally:
            run.close()


def _explore(run: LockstepRun, case: LeaderlessCase) -> LeaderlessRun:
    weights = _weights(run)
    team_s = last_s = killed_s = math.inf
    look_s = 0.0
    while run.sim_time_s < case.time_limit_s and last_s == math.inf:
        run.tick()
        known, now_s = run.explored_fraction, run.sim_time_s
        if case.killed_at is not None and killed_s == math.inf and known >= case.killed_at:
            killed_s = now_s
            run.end_coordinator()
        if known >= KNOWN and team_s == math.inf:
            team_s = now_s
        if team_s < math.inf and now_s >= look_s:
            look_s = now_s + LOOK_S
            if all(_known_by(run, robot, weights) >= KNOWN for robot in range(len(run.hosts))):
                last_s = now_s
    return LeaderlessRun(
        case=case,
        team_s=team_s,
        last_s=last_s,
        killed_s=killed_s,
        known=run.explored_fraction,
        collisions=run.arena.collisions,
    )


def _weights(run: LockstepRun) -> NDArray[np.int64]:
    """What each cell of the team's grid counts."""
    world = run.world
    starts = [Point2D(robot.start.x_m, robot.start.y_m) for robot in world.robots]
    clearance_m = least_clearance_m(min(robot.radius_m for robot in world.robots))
    return floor_weights(world.plan, starts, clearance_m, run.arena.referee.grid.geometry)


def _known_by(run: LockstepRun, robot: int, weights: NDArray[np.int64]) -> float:
    """Share of the floor that a robot knows by its own map."""
    grid = run.hosts[robot].board.map
    return 0.0 if grid is None else float(weights[grid.classes() >= 0].sum() / weights.sum())
