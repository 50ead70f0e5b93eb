"""The exploration lab in short: the default strategy beside the others with points, and beside the full stack.

Everything but the last figure depends on the seeds alone. `robrain bench exploration` makes the same with more floors.
"""

import math
import time
from collections.abc import Iterator, Sequence

from robrain.algorithms.exploration.strategies import STRATEGIES
from robrain.algorithms.warm_up import warm_up
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.lab.bench.exploration import FULL, POINTS, ExplorationCase, ExplorationRun, by_group, run_case
from robrain.lab.bench.figure import Figure, at_least, at_most, deterministic, timing
from robrain.lab.bench.mapping_plan import OWN_MAPS

FLOOR = "clinic"
SEEDS = range(51, 53)
"""Not used to choose any constant."""
TEAMS = (1, 4)
FULL_SEEDS = SEEDS[:1]
PERCENT = 95
DEFAULT = PlanningPolicy().exploration
OVER_BEST = 1.1
"""Bound on the default's time over the best strategy's: two seeds tell no more."""
OVER_POINTS = 1.25
"""Bound on the full stack's time over that of points, one robot."""
SPEED_UP = 3.2
LONGEST_S = {1: 82.0, 4: 34.0}
"""The measured values plus a tenth for different routes."""


def case(strategy: str, robots: int, seed: int, motion: str = POINTS) -> ExplorationCase:
    """One run."""
    path = str(OWN_MAPS / f"{FLOOR}.yaml")
    return ExplorationCase(map=FLOOR, path=path, robots=robots, seed=seed, strategy=strategy, motion=motion)


def measure() -> Iterator[Figure]:
    """All strategies with points, and the default with the full stack."""
    warm_up()
    began_s = time.perf_counter()
    runs = [
        run_case(case(strategy, robots, seed)) for strategy in STRATEGIES.names for robots in TEAMS for seed in SEEDS
    ]
    took_s = time.perf_counter() - began_s
    yield from points_figures(runs)
    yield from full_figures(runs, [run_case(case(DEFAULT, 1, seed, FULL)) for seed in FULL_SEEDS])
    yield timing("points: one run, mean", took_s / len(runs), "s")


def points_figures(runs: Sequence[ExplorationRun]) -> Iterator[Figure]:
    """The default's times, beside the best strategy's of each team, and its speed-up."""
    times_s = {(group.robots, group.strategy): mean_s(made) for group, made in by_group(runs).items()}
    for robots in TEAMS:
        best = min(STRATEGIES.names, key=lambda strategy: times_s[robots, strategy])
        own_s = times_s[robots, DEFAULT]
        name = f"{FLOOR}, {robots} {'robot' if robots == 1 else 'robots'}, points"
        yield deterministic(f"{name}: {PERCENT} % known", own_s, "s", at_most(LONGEST_S[robots]))
        ratio = own_s / times_s[robots, best]
        yield deterministic(f"{name}: time over the best strategy's", ratio, "×", at_most(OVER_BEST), f"best: {best}")
    speed_up = times_s[1, DEFAULT] / times_s[4, DEFAULT]
    yield deterministic(f"{FLOOR}, 4 robots, points: speed-up", speed_up, "×", at_least(SPEED_UP))


def full_figures(points: Sequence[ExplorationRun], full: Sequence[ExplorationRun]) -> Iterator[Figure]:
    """One robot with the full stack over the same seeds with points."""
    seeds = {run.case.seed for run in full}
    alike = [run for run in points if run.case.seed in seeds and run.case.robots == 1 and run.case.strategy == DEFAULT]
    name = f"{FLOOR}, 1 robot, full stack"
    ratio = mean_s(full) / mean_s(alike)
    yield deterministic(f"{name}: time over that of points", ratio, "×", at_most(OVER_POINTS))
    yield deterministic(f"{name}: collisions", sum(run.collisions for run in full), "", at_most(0))


def mean_s(runs: Sequence[ExplorationRun]) -> float:
    """Mean time of `PERCENT`; inf if there is no run, or one did not come so far."""
    times_s = [run.explored_percent_s.get(PERCENT, math.inf) for run in runs]
    return sum(times_s) / len(times_s) if times_s else math.inf
