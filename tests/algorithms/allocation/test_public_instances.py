"""A public instance with a published best value, read by `vrplib` and solved through our model.

`data/R101_25.txt` is R101 of Solomon (Algorithms for the Vehicle Routing and Scheduling Problems with Time Window
Constraints, Operations Research 35(2), 1987) cut to its first 25 customers, which is how the set's instances of 25 are
made. The optimum published for it is 617.1 with 8 vehicles; ways are cut to one decimal there.

Our jobs have no demand. Demands are therefore no part of the problem that is solved, and it is checked that no route
exceeds the capacity: what is best without capacities and keeps them is best with them.
"""

from pathlib import Path

import numpy as np
import pytest
import vrplib

from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.algorithms.allocation.problem import Job, Objective, Problem, Worker
from robrain.algorithms.allocation.validate import validate

pytestmark = pytest.mark.slow

BEST_KNOWN = 617.1


def never():
    raise AssertionError("the clock is not read where only iterations count")


def read_solomon(path):
    """An instance of Solomon's format as a problem: distance is energy, and time too."""
    instance = vrplib.read_instance(path, instance_format="solomon")
    ways = np.floor(instance["edge_weight"] * 10) / 10
    windows, service_s = instance["time_window"], instance["service_time"]
    jobs = tuple(
        Job(
            id=f"c{customer}",
            place=customer,
            prize_j=1e4,
            service_s=float(service_s[customer]),
            earliest_s=float(windows[customer][0]),
            # There a window is that of the beginning, here it is that of the end.
            latest_s=float(windows[customer][1] + service_s[customer]),
        )
        for customer in range(1, len(ways))
    )
    workers = tuple(
        Worker(name=f"v{number}", start=0, ends=(0,), usable_j=1e5) for number in range(instance["vehicles"])
    )
    problem = Problem(
        jobs=jobs, workers=workers, energy_j=ways[None], time_s=ways[None], horizon_s=float(windows[0][1])
    )
    return problem, instance["demand"], instance["capacity"]


def test_best_value_of_a_public_instance_is_found():
    problem, demand, capacity = read_solomon(Path(__file__).parent / "data" / "R101_25.txt")
    plan = OptimalAllocator(Objective.ENERGY, never).plan(problem, iterations=3000)
    assert validate(problem, plan) == []
    assert not plan.unassigned
    assert round(plan.value, 6) == BEST_KNOWN
    assert sum(bool(route.stops) for route in plan.routes) == 8
    for route in plan.routes:
        assert sum(demand[problem.jobs[problem.job_index[job]].place] for job in route.jobs) <= capacity
