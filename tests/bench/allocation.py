"""Allocation, as `robrain bench allocation` measures it.

`python -m tests.bench.allocation best` looks for better plans of the large instances, two minutes of a core each. It
writes them into `lab/bench/allocation/allocation_best.json`; figures of ours are compared with what stands there.
"""

import sys
import time

import msgspec
from rich.console import Console

from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.algorithms.allocation.plan import Plan
from robrain.algorithms.allocation.problem import Objective
from robrain.lab.bench.allocation.allocation import (
    BEST,
    GAP_BOUND,
    SIZES,
    BestKnown,
    instance,
    measure,
    name_of,
    read_best,
)
from robrain.lab.bench.figure import WIDTH, show_figures

__all__ = ["measure"]

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
        show_figures("Allocation", measure(), Console(width=WIDTH))
