"""Allocation: the first plan's time, and how far plans are from the best known and from the exact optimum.

`python -m tests.bench.allocation best` looks for better plans of the large instances, two minutes of a core each. It
writes `allocation_best.json` beside this file where it finds some; figures of ours are compared with what stands there.

Seconds are seconds of one core (`time.process_time`), so that the figures do not depend on what else the machine does.
"""

import json
import sys
import time
from pathlib import Path
from typing import NamedTuple

from robrain.coordinator.allocation.auction import AuctionAllocator, GreedyAllocator
from robrain.coordinator.allocation.optimal import OptimalAllocator
from robrain.coordinator.allocation.plan import Plan
from robrain.coordinator.allocation.problem import Objective, Problem
from robrain.coordinator.allocation.validate import validate
from robrain.coordinator.allocation.warm_up import warm_up
from tests.coordinator.allocation.instances import team_problem
from tests.coordinator.allocation.oracle import exact_plan

BEST = Path(__file__).with_name("allocation_best.json")
SIZES = ((5, 50), (20, 200), (100, 1000))
SEED = 1
TIGHTNESS = {Objective.ENERGY: 0.75, Objective.MAKESPAN: 0.4}
"""Budgets of the instances. For the makespan they are such that everything can be done by everybody's best; otherwise
two makespans with different prizes lost would be compared."""
THINK_S = 5.0
BEST_S = 120.0
SHORT_S = 1.0
SEARCH_SEEDS = 1
"""Searches an instance; more for a fuller figure."""
FIRST_BOUND_MS = {5: 10.0, 20: 50.0, 100: 600.0}
GAP_BOUND = {
    Objective.ENERGY: {5: 0.01, 20: 0.02, 100: 0.15},
    Objective.MAKESPAN: {5: 0.03, 20: 0.05, 100: 0.12},
}
EXACT_SIZES = ((2, 9), (3, 8), (3, 11), (4, 8), (6, 6))
EXACT_ITERATIONS = 1500


class Row(NamedTuple):
    """One figure."""

    what: str
    value: str
    beside: str
    """What it is compared with."""
    bound: str
    is_kept: bool


def measure() -> list[Row]:
    """All figures of the allocators."""
    warm_up()
    return [*_exact_gaps(), *_first_plans(), *_best_known_gaps()]


def instance(robots: int, tasks: int, objective: Objective) -> Problem:
    """Own starts, four classes of speed and power, tight budgets."""
    return team_problem(robots, tasks, SEED, tightness=TIGHTNESS[objective])


def _first_plans() -> list[Row]:
    rows = []
    for robots, tasks in SIZES:
        problem = instance(robots, tasks, Objective.ENERGY)
        took_ms = []
        for _ in range(5):
            begin_s = time.process_time()
            plan = AuctionAllocator().plan(problem)
            took_ms.append(1e3 * (time.process_time() - begin_s))
        median_ms, bound_ms = sorted(took_ms)[2], FIRST_BOUND_MS[robots]
        is_kept = median_ms <= bound_ms and not validate(problem, plan)
        what = f"{robots} × {tasks}: first feasible plan (auction)"
        rows.append(
            Row(what, f"{median_ms:.1f} ms", f"slowest of 5: {max(took_ms):.1f} ms", f"<= {bound_ms:g} ms", is_kept)
        )
    problem = instance(100, 1000, Objective.ENERGY)
    begin_s = time.process_time()
    OptimalAllocator(Objective.ENERGY, time.process_time).plan(problem, deadline_s=SHORT_S)
    took_s = time.process_time() - begin_s
    what = "100 × 1000: answer of optimal with a short deadline"
    rows.append(
        Row(what, f"{took_s:.3f} s", "the auction alone is the first answer", f"<= {SHORT_S:g} s", took_s <= SHORT_S)
    )
    return rows


def _best_known_gaps() -> list[Row]:
    best = json.loads(BEST.read_text(encoding="utf-8"))["instances"] if BEST.exists() else {}
    rows = []
    for objective, bounds in GAP_BOUND.items():
        for robots, tasks in SIZES:
            problem = instance(robots, tasks, objective)
            known = best.get(_name(robots, tasks, objective), {"value": float("nan"), "lost_prize_j": 0.0})
            plans = [
                OptimalAllocator(objective, time.process_time).plan(problem, deadline_s=THINK_S, seed=seed)
                for seed in range(SEARCH_SEEDS)
            ]
            gap = sum(plan.value for plan in plans) / len(plans) / known["value"] - 1
            auction, greedy = (
                kind(objective).plan(problem).value / known["value"] - 1 for kind in (AuctionAllocator, GreedyAllocator)
            )
            is_comparable = all(_is_comparable(plan, known) for plan in plans)
            is_kept = gap <= bounds[robots] and is_comparable and not any(validate(problem, plan) for plan in plans)
            rows.append(
                Row(
                    f"{robots} × {tasks}: {objective} after {THINK_S:g} s of a core, over the best known",
                    f"{100 * gap:.2f} %" + ("" if is_comparable else " (other prizes lost)"),
                    f"auction {100 * auction:.0f} %, greedy {100 * greedy:.0f} %",
                    f"<= {100 * bounds[robots]:g} %",
                    is_kept,
                )
            )
    return rows


def _is_comparable(plan: Plan, known: dict[str, float]) -> bool:
    return plan.objective is Objective.ENERGY or abs(plan.lost_prize_j - known["lost_prize_j"]) < 1


def _exact_gaps() -> list[Row]:
    rows = []
    kinds = {"energy, all must be done": None, "energy and prizes": (2.0, 10.0)}
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
        rows.append(
            Row(
                f"{name}: worst gap of optimal to the exact optimum, {count} instances of <= 36 pairs",
                f"{100 * worst:.3f} %",
                f"auction {gaps['auction']}, greedy {gaps['greedy']} in the mean",
                "<= 0.5 %",
                worst <= 0.005 and count == len(EXACT_SIZES),
            )
        )
    return [*rows, _coupled_gaps()]


def _coupled_gaps() -> Row:
    """Where jobs wait for each other there is no bound to keep: this is what the windows leave out."""
    gaps = []
    for seed in range(4):
        problem = team_problem(3, 8, seed, tightness=0.9, after=0.3, pairs=0.3)
        exact = exact_plan(problem)
        plan = OptimalAllocator(Objective.ENERGY, time.process_time).plan(problem, iterations=2 * EXACT_ITERATIONS)
        if exact is not None:
            gaps.append(plan.value / exact.value - 1)
    what = "energy and prizes, 30 % of the jobs after others, 30 % for two robots: worst gap of optimal, 4 of 3 × 8"
    return Row(what, f"{100 * max(gaps):.1f} %", f"{100 * sum(gaps) / len(gaps):.1f} % in the mean", "none", True)


# -- best known ---------------------------------------------------------------------------------------------------


def _name(robots: int, tasks: int, objective: Objective) -> str:
    return f"{robots}x{tasks} {objective}"


def find_best(seeds: tuple[int, ...] = (11,)) -> None:
    """Search long, and keep what is better than what is known."""
    found = json.loads(BEST.read_text(encoding="utf-8")) if BEST.exists() else {"instances": {}}
    found["how"] = (
        f"python -m tests.bench.allocation best SEED ...: {BEST_S:g} s of a core each (a quarter for 5 × 50),"
        " the best of all such runs"
    )
    for objective in GAP_BOUND:
        for robots, tasks in SIZES:
            problem = instance(robots, tasks, objective)
            for seed in seeds:
                known = found["instances"].get(_name(robots, tasks, objective))
                think_s = BEST_S if tasks > 50 else BEST_S / 4
                plan = OptimalAllocator(objective, time.process_time).plan(problem, deadline_s=think_s, seed=seed)
                if (
                    known is None
                    or (plan.objective is Objective.ENERGY and plan.value < known["value"])
                    or (
                        plan.objective is not Objective.ENERGY
                        and (round(plan.lost_prize_j), plan.value) < (round(known["lost_prize_j"]), known["value"])
                    )
                ):
                    found["instances"][_name(robots, tasks, objective)] = {
                        "value": round(plan.value, 3),
                        "lost_prize_j": round(plan.lost_prize_j, 3),
                        "seed": seed,
                    }
                    BEST.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:2] == ["best"]:
        find_best(tuple(int(seed) for seed in sys.argv[2:]) or (11,))
    else:
        for row in measure():
            sys.stdout.write(" | ".join([*row[:4], "yes" if row.is_kept else "no"]) + "\n")
