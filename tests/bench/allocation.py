"""Allocation: the time of the first plan, and how far plans are from the best known and from the exact optimum.

Seconds are seconds of one core (`time.process_time`), so that the figures do not depend on what else the machine does.
`python -m tests.bench.allocation best` looks for better plans of the large instances, two minutes of a core each, and
writes them into `allocation_best.json` beside this file.
"""

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec

from robrain.algorithms.allocation.auction import AuctionAllocator, GreedyAllocator
from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.algorithms.allocation.plan import Plan
from robrain.algorithms.allocation.problem import Objective, Problem
from robrain.algorithms.allocation.validate import validate
from robrain.algorithms.allocation.warm_up import warm_up
from robrain.lab.bench.figure import Figure, at_least, at_most, deterministic, timing
from tests.algorithms.allocation.instances import team_problem
from tests.bench.processes import show

BEST = Path(__file__).with_name("allocation_best.json")
SIZES = ((5, 50), (20, 200), (100, 1000))
SEED = 1
TIGHTNESS = {Objective.ENERGY: 0.75, Objective.MAKESPAN: 0.4}
"""Budgets of the instances. For the makespan they are such that everything can be done by everybody's best; otherwise
two makespans with different prizes lost would be compared."""
THINK_S = 5.0
SHORT_S = 1.0
SEARCH_SEEDS = 1
"""Searches an instance; more for a fuller figure."""
FIRST_BOUND_MS = {5: 10.0, 20: 50.0, 100: 600.0}
GAP_BOUND = {Objective.ENERGY: {5: 0.01, 20: 0.02, 100: 0.15}, Objective.MAKESPAN: {5: 0.03, 20: 0.05, 100: 0.12}}
EXACT_SIZES = ((2, 9), (3, 8), (3, 11), (4, 8), (6, 6))
EXACT_BOUND = 0.005
EXACT_ITERATIONS = 1500


class BestKnown(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The best plan found so far of an instance."""

    value: float
    lost_prize_j: float
    seed: int = 0


class BestFile(msgspec.Struct, forbid_unknown_fields=True):
    """What is in `allocation_best.json`."""

    instances: dict[str, BestKnown] = {}
    how: str = ""


def measure(sizes: tuple[tuple[int, int], ...] = SIZES) -> Iterator[Figure]:
    """All figures of the allocators, one after the other as they are found.

    Args:
        sizes: robots and tasks of the large instances, some of `SIZES`.

    """
    warm_up()
    yield from _exact_gaps()
    yield from _first_plans(sizes)
    yield from _best_known_gaps(sizes)


def instance(robots: int, tasks: int, objective: Objective) -> Problem:
    """Own starts, four classes of speed and power, tight budgets."""
    return team_problem(robots, tasks, SEED, tightness=TIGHTNESS[objective])


def _first_plans(sizes: tuple[tuple[int, int], ...]) -> Iterator[Figure]:
    for robots, tasks in sizes:
        problem = instance(robots, tasks, Objective.ENERGY)
        durations_ms = []
        for _ in range(5):
            begin_s = time.process_time()
            plan = AuctionAllocator().plan(problem)
            durations_ms.append(1e3 * (time.process_time() - begin_s))
        what = f"{robots} × {tasks}: first feasible plan (auction)"
        slowest = f"median of 5, slowest {max(durations_ms):.1f} ms"
        yield timing(f"{what}, CPU", sorted(durations_ms)[2], "ms", at_most(FIRST_BOUND_MS[robots]), slowest)
        yield deterministic(f"{what}: rules that it breaks", len(validate(problem, plan)), bound=at_most(0))
    robots, tasks = sizes[-1]
    problem = instance(robots, tasks, Objective.ENERGY)
    begin_s = time.process_time()
    OptimalAllocator(Objective.ENERGY, time.process_time).plan(problem, deadline_s=SHORT_S)
    took_s = time.process_time() - begin_s
    what = f"{robots} × {tasks}: answer of optimal with a deadline of {SHORT_S:g} s, CPU"
    yield timing(what, took_s, "s", at_most(SHORT_S), "the auction alone is the first answer")


def _best_known_gaps(sizes: tuple[tuple[int, int], ...]) -> Iterator[Figure]:
    best = read_best().instances
    for objective, bounds in GAP_BOUND.items():
        for robots, tasks in sizes:
            problem = instance(robots, tasks, objective)
            known = best.get(name_of(robots, tasks, objective), BestKnown(float("nan"), 0.0))
            plans = [
                OptimalAllocator(objective, time.process_time).plan(problem, deadline_s=THINK_S, seed=seed)
                for seed in range(SEARCH_SEEDS)
            ]
            gap = sum(plan.value for plan in plans) / len(plans) / known.value - 1
            auction, greedy = (
                kind(objective).plan(problem).value / known.value - 1 for kind in (AuctionAllocator, GreedyAllocator)
            )
            what = f"{robots} × {tasks}: {objective} after {THINK_S:g} s of a core"
            beside = f"auction {100 * auction:.0f} %, greedy {100 * greedy:.0f} %"
            yield timing(f"{what}, over the best known", 100 * gap, "%", at_most(100 * bounds[robots]), beside)
            wrong = sum(bool(validate(problem, plan)) or not _is_comparable(plan, known) for plan in plans)
            beside = "rules broken, or other prizes lost than by the best known"
            yield timing(f"{what}: plans that cannot be compared", wrong, bound=at_most(0), beside=beside)


def _is_comparable(plan: Plan, known: BestKnown) -> bool:
    return plan.objective is Objective.ENERGY or abs(plan.lost_prize_j - known.lost_prize_j) < 1


def _exact_gaps() -> Iterator[Figure]:
    from tests.algorithms.allocation.oracle import exact_plan  # ortools is needed for nothing else

    kinds: dict[str, tuple[float, float] | None] = {"energy, all must be done": None, "energy and prizes": (2.0, 10.0)}
    for name, prize_j in kinds.items():
        worst, sums, exact_sum = 0.0, {"optimal": 0.0, "auction": 0.0, "greedy": 0.0}, 0.0
        count = 0
        for robots, tasks in EXACT_SIZES:
            problem = team_problem(robots, tasks, SEED, prize_j=prize_j, tightness=None if prize_j is None else 0.9)
            exact = exact_plan(problem)
            if exact is None:
                continue
            plans = {
                "optimal": OptimalAllocator(Objective.ENERGY, time.process_time).plan(
                    problem, iterations=EXACT_ITERATIONS
                ),
                "auction": AuctionAllocator().plan(problem),
                "greedy": GreedyAllocator().plan(problem),
            }
            count += 1
            exact_sum += exact.value
            worst = max(worst, plans["optimal"].value / exact.value - 1)
            for kind, plan in plans.items():
                sums[kind] += plan.value
        gaps = {kind: f"{100 * (total / exact_sum - 1):.2f} %" for kind, total in sums.items()}
        yield deterministic(
            f"{name}: worst gap of optimal to the exact optimum, instances of <= 36 pairs",
            100 * worst,
            "%",
            at_most(100 * EXACT_BOUND),
            f"mean of auction {gaps['auction']}, of greedy {gaps['greedy']}",
        )
        yield timing(f"{name}: instances with a proved optimum", count, bound=at_least(len(EXACT_SIZES)))
    yield _coupled_gaps()


def _coupled_gaps() -> Figure:
    """Where jobs wait for each other there is no bound to keep: this is what the windows leave out."""
    from tests.algorithms.allocation.oracle import exact_plan

    gaps = []
    for seed in range(4):
        problem = team_problem(3, 8, seed, tightness=0.9, after=0.3, pairs=0.3)
        exact = exact_plan(problem)
        plan = OptimalAllocator(Objective.ENERGY, time.process_time).plan(problem, iterations=2 * EXACT_ITERATIONS)
        if exact is not None:
            gaps.append(plan.value / exact.value - 1)
    what = "energy and prizes, 30 % of the jobs after others, 30 % for two robots: worst gap of optimal, 4 of 3 × 8"
    return deterministic(what, 100 * max(gaps), "%", beside=f"{100 * sum(gaps) / len(gaps):.1f} % in the mean")


# -- best known ---------------------------------------------------------------------------------------------------


def read_best() -> BestFile:
    """What is known of the large instances."""
    return msgspec.json.decode(BEST.read_bytes(), type=BestFile) if BEST.exists() else BestFile()


def name_of(robots: int, tasks: int, objective: Objective) -> str:
    """Name of an instance among the best known."""
    return f"{robots}x{tasks} {objective}"


BEST_S = 120.0


def find_best(seeds: tuple[int, ...] = (11,)) -> None:
    """Search long, and keep what is better than what is known."""
    found = read_best()
    found.how = (
        f"python -m tests.bench.allocation best SEED ...: {BEST_S:g} s of a core each (a quarter for 5 × 50),"
        " the best of all such runs"
    )
    for objective in GAP_BOUND:
        for robots, tasks in SIZES:
            problem = instance(robots, tasks, objective)
            for seed in seeds:
                known = found.instances.get(name_of(robots, tasks, objective))
                think_s = BEST_S if tasks > 50 else BEST_S / 4
                plan = OptimalAllocator(objective, time.process_time).plan(problem, deadline_s=think_s, seed=seed)
                if known is None or _is_better(plan, known):
                    better = BestKnown(round(plan.value, 3), round(plan.lost_prize_j, 3), seed)
                    found.instances[name_of(robots, tasks, objective)] = better
                    BEST.write_bytes(msgspec.json.format(msgspec.json.encode(found), indent=2) + b"\n")


def _is_better(plan: Plan, known: BestKnown) -> bool:
    if plan.objective is Objective.ENERGY:
        return plan.value < known.value
    return (round(plan.lost_prize_j), plan.value) < (round(known.lost_prize_j), known.value)


if __name__ == "__main__":
    if sys.argv[1:2] == ["best"]:
        find_best(tuple(int(seed) for seed in sys.argv[2:]) or (11,))
    else:
        show("Allocation", measure())
