"""`python -m tests.bench.leaderless`: exploration whose coordinator is killed on the way, beside undisturbed runs."""

import math
from collections.abc import Iterator, Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.algorithms.navigation.clearance import least_clearance_m
from robrain.deploy.processes.kernels import prepare_kernels
from robrain.lab.bench.figure import Figure, at_most, deterministic
from robrain.lab.bench.mapping_plan import errors_alone
from robrain.protocol.model.geometry import Point2D
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.maps.placement import Starts
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.referee import floor_weights
from tests.bench.processes import show

KNOWN = 0.95
"""Share of the floor at which a run ends."""
KILLED_AT = 0.3
"""Share of the floor that is known when the coordinator is killed."""
MAPS, ROBOTS, SEEDS = ("depot", "office", "hospital"), 4, range(1, 5)
LOOK_S = 1.0
"""Period in which each robot's own map is looked at."""


class LeaderlessCase(msgspec.Struct, frozen=True, kw_only=True):
    """One run."""

    map: str
    robots: int
    seed: int
    consensus: bool = True
    """Whether robots may go on without a coordinator."""
    killed_at: float | None = KILLED_AT
    """Share of the floor that is known when the coordinator is killed; None leaves it alone."""
    time_limit_s: float = 900.0

    def scenario(self) -> Scenario:
        """The scenario of the run."""
        found = Scenario.builtin(self.map)
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


OVER_UNDISTURBED = 1.25
"""Largest mean time without a coordinator over the mean time with one."""


def measure() -> Iterator[Figure]:
    """Each run undisturbed, then with the coordinator killed."""
    prepare_kernels()
    yield from figures(
        [
            run_case(LeaderlessCase(map=name, robots=ROBOTS, seed=seed, killed_at=killed_at))
            for name in MAPS
            for seed in SEEDS
            for killed_at in (None, KILLED_AT)
        ]
    )


def pairs(runs: Sequence[LeaderlessRun]) -> list[tuple[LeaderlessRun, LeaderlessRun]]:
    """Each undisturbed run with the one whose coordinator was killed."""
    found = {msgspec.structs.replace(run.case, killed_at=None): run for run in runs if run.case.killed_at is not None}
    return [(run, found[run.case]) for run in runs if run.case.killed_at is None and run.case in found]


def figures(runs: Sequence[LeaderlessRun]) -> Iterator[Figure]:
    """The ratio of mean times for each map and number of robots, and the collisions of all runs."""
    groups: dict[tuple[str, int], list[tuple[LeaderlessRun, LeaderlessRun]]] = {}
    for calm, killed in pairs(runs):
        groups.setdefault((calm.case.map, calm.case.robots), []).append((calm, killed))
    for (name, robots), made in groups.items():
        calm_s = math.fsum(calm.team_s for calm, _ in made) / len(made)
        killed_s = math.fsum(killed.team_s for _, killed in made) / len(made)
        beside = f"{calm_s:.0f} s undisturbed, {killed_s:.0f} s without, {len(made)} seeds"
        what = f"{name}, {robots} robots: time without a coordinator over undisturbed"
        yield deterministic(what, killed_s / calm_s, bound=at_most(OVER_UNDISTURBED), beside=beside)
    hits = sum(run.collisions for run in runs)
    yield deterministic("collisions in all runs", hits, bound=at_most(0), beside=f"{len(runs)} runs")


if __name__ == "__main__":
    show("Exploration without a coordinator", measure())
