"""Planning: what a team takes for a dozen tasks that are planned, against nearest first, with real robots in lockstep.

The team first explores the floor, the same for both. Then it stops exploring, and the tasks come all at once. `SEEDS`
of them; each is another set of tasks. `python -m tests.bench.planning`.
"""

import statistics
import sys
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from robrain.algorithms.exploration.strategies import NO_EXPLORATION
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.lab.bench.figure import Figure, at_least, below, deterministic
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.maps.placement import scatter_points
from robrain.sim.scenarios.scenario import Scenario
from tests.bench.processes import show
from tests.bench.side_by_side import side_by_side

FLOOR = "depot"
ROBOTS, TASKS = 3, 12
SEEDS = (1, 2, 3)
EXPLORED = 0.93
EXPLORE_LIMIT_S = 120.0
LONGEST_S = 600.0
SETTLE_S = 10.0
"""For robots that were exploring: what idle robots explore is no cost of the tasks."""
CLEARANCE_M = 0.5
STANDING_W = 8.0
"""What each robot draws whatever it does; no plan changes that, but a short one ends it sooner."""
MEASURES = {
    "energy": ("energy_j", "J"),
    "energy of moving": ("moving_j", "J"),
    "way": ("distance_m", "m"),
    "makespan": ("makespan_s", "s"),
}
"""Compared quantities: field of `Outcome`, unit."""
BOUND_OF = {"planned, energy": "moving_j", "planned, makespan": "makespan_s"}
"""The quantity in which each planning method has to beat nearest first."""


class Outcome(NamedTuple):
    """One run, from the moment at which the tasks came."""

    energy_j: float
    """Of all robots, standing included."""
    moving_j: float
    """The same without what standing takes."""
    distance_m: float
    makespan_s: float
    done: int


def measure(seeds: tuple[int, ...] = SEEDS) -> list[Figure]:
    """The table's rows: each a way of deciding, against nearest first."""
    ways = {
        "nearest first": PlanningPolicy(method="nearest"),
        "auction, energy": PlanningPolicy(method="auction"),
        "planned, energy": PlanningPolicy(),
        "planned, makespan": PlanningPolicy(objective=Objective.MAKESPAN),
    }
    outcomes = iter(side_by_side(_run_case, [(seed, policy) for policy in ways.values() for seed in seeds]))
    by_way = {name: [next(outcomes) for _ in seeds] for name in ways}
    base = by_way["nearest first"]
    figures = []
    for name, found in by_way.items():
        team, wanted = f"{ROBOTS} robots, {TASKS} tasks, {name}", TASKS * len(found)
        done = sum(one.done for one in found)
        figures.append(deterministic(f"{team}: done, of {wanted}", done, "", at_least(wanted)))
        for what, (field, unit) in MEASURES.items():
            if found is base:
                figures.append(deterministic(f"{team}: {what}, mean", _mean(found, field), unit))
                continue
            bound = below(100.0) if BOUND_OF.get(name) == field else None
            beside = f"{_mean(found, field):.0f} {unit} in the mean"
            share = 100 * _share(found, base, field)
            figures.append(deterministic(f"{team}: {what}, over nearest first", share, "%", bound, beside))
    return figures


def _run_case(case: tuple[int, PlanningPolicy]) -> Outcome:
    return run_tasks(*case)


def run_tasks(seed: int, policy: PlanningPolicy, floor: str = FLOOR, record: Path | None = None) -> Outcome:
    """Explore, then do a set of tasks that only the seed decides."""
    scenario = Scenario.builtin(floor).replace(robots=ROBOTS, motes=0, planning=policy)
    with scenario.team(seed=seed, record=record, by="bench") as team:
        run = team.transport.run
        while run.explored_fraction < EXPLORED and run.sim_time_s < EXPLORE_LIMIT_S:
            run.tick()
        run.coordinator.set_policy(msgspec.structs.replace(policy, exploration=NO_EXPLORATION))
        team.run_for(SETTLE_S)
        places = known_places(run, np.random.default_rng([seed, 77]), 3 * TASKS, 1.0)[:TASKS]
        begun_s = run.sim_time_s
        energy_j, distance_m = _spent(run)
        for number, place in enumerate(places):
            team.submit("visit", id=f"t{number}", place=place, service_s=2.0)
        team.run_for(LONGEST_S, until=lambda: all(record.state.ended for record in team.list()))
        spent_j, gone_m = _spent(run)
        done = sum(record.state is TaskState.DONE for record in team.list())
        took_s, took_j = run.sim_time_s - begun_s, spent_j - energy_j
        return Outcome(took_j, took_j - ROBOTS * STANDING_W * took_s, gone_m - distance_m, took_s, done)


def known_places(run: LockstepRun, rng: np.random.Generator, count: int, spacing_m: float) -> list[Point2D]:
    """Of so many places, those on floor that the team knows, so that nobody has to find the way first."""
    plan, grid = run.world.plan, run.coordinator.team_map.grid
    starts = [Point2D(robot.start.x_m, robot.start.y_m) for robot in run.world.robots]
    reachable = plan.reachable(starts, run.world.robots[0].radius_m)
    found = scatter_points(plan, count, reachable, rng=rng, min_clearance_m=CLEARANCE_M, spacing_m=spacing_m)
    return [
        place for place in found if grid is not None and grid.log_odds[grid.geometry.cell_of(place.x_m, place.y_m)] < 0
    ]


def _spent(run: LockstepRun) -> tuple[float, float]:
    robots = run.truth.robots
    return sum(robot.energy_j for robot in robots), sum(robot.distance_m for robot in robots)


def _mean(outcomes: list[Outcome], field: str) -> float:
    return statistics.fmean(getattr(one, field) for one in outcomes)


def _share(outcomes: list[Outcome], base: list[Outcome], field: str) -> float:
    return statistics.fmean(
        getattr(one, field) / getattr(other, field) for one, other in zip(outcomes, base, strict=True)
    )


if __name__ == "__main__":
    seeds = tuple(int(text) for text in sys.argv[1:]) or SEEDS
    show("Planning", measure(seeds))
