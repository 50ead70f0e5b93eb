"""When a plan is worth a change of hands, and how long better ones are looked for."""

import msgspec
import numpy as np
import pytest

from robrain.algorithms.allocation.problem import Job, Objective, Problem, Worker
from robrain.coordinator.planning.plan_search import FRUITLESS, PlanSolver
from robrain.coordinator.planning.policy import PlanningPolicy


def problem(*jobs, j_per_m=1.0, usable_j=100.0):
    """Places 0 to 4 on a line, a metre and a second apart; r0 begins and ends at 0, r1 at 4."""
    length_m = np.abs(np.subtract.outer(np.arange(5.0), np.arange(5.0)))[None]
    workers = tuple(Worker(name=f"r{k}", start=4 * k, ends=(4 * k,), usable_j=usable_j) for k in range(2))
    return Problem(jobs=jobs, workers=workers, energy_j=j_per_m * length_m, time_s=length_m)


def job(name, place):
    return Job(id=name, place=place, prize_j=1000.0)


def orders_after(asked, objective=Objective.ENERGY, *, gain_min, orders):
    solver = PlanSolver(asked, PlanningPolicy(objective=objective, method="auction", gain_min=gain_min), orders)
    return {route.worker: route.jobs for route in solver.plan.routes if route.jobs}


@pytest.mark.parametrize(
    ("objective", "gain", "j_per_m"),
    [
        (Objective.ENERGY, 4 / 6, 1.0),
        (Objective.ENERGY, 4 / 6, 0.1),
        (Objective.MAKESPAN, 4 / 6, 1.0),
        (Objective.LIFETIME, 4 / 94, 1.0),
    ],
)
def test_it_is_better_by_enough_from_the_share_that_is_asked_for(objective, gain, j_per_m):
    """r1 would take six metres for it, r0 two: 4 J of 6, 4 s of 6, and 2 J more of 94 left."""
    asked = problem(job("a", 1), j_per_m=j_per_m)
    for gain_min, robot in ((gain - 1e-9, "r0"), (gain + 1e-9, "r1")):
        assert orders_after(asked, objective, gain_min=gain_min, orders={"r1": ["a"]}) == {robot: ("a",)}


def test_whatever_a_plan_leaves_is_enough_where_the_one_before_leaves_nothing():
    asked = problem(job("a", 1), j_per_m=0.125, usable_j=0.75)
    assert orders_after(asked, Objective.LIFETIME, gain_min=0.99, orders={"r1": ["a"]}) == {"r0": ("a",)}


def test_a_task_that_nobody_was_to_do_is_done_however_little_it_gains():
    found = orders_after(problem(job("a", 1), job("b", 1)), gain_min=0.999, orders={"r1": ["a"]})
    assert sorted(name for jobs in found.values() for name in jobs) == ["a", "b"]


def solver_of(*jobs, method="optimal"):
    return PlanSolver(problem(*jobs), PlanningPolicy(method=method, seed=5, iterations=10, gain_min=0.0))


@pytest.mark.parametrize(
    ("jobs", "method", "rounds"), [(1, "optimal", 0), (2, "optimal", FRUITLESS), (2, "auction", 0)]
)
def test_better_plans_are_looked_for_where_there_may_be_any(jobs, method, rounds):
    solver = solver_of(*(job(f"t{k}", 1 + k) for k in range(jobs)), method=method)
    assert sum(1 for _ in solver.improve()) == solver.rounds == rounds


def test_a_task_that_a_robot_is_at_is_none_that_can_be_planned_better():
    pinned = Job(id="b", place=1, prize_j=1.0, pinned_to="r0")
    assert list(solver_of(job("a", 1), pinned).improve()) == []


@pytest.mark.parametrize("better_in", [0, 1, FRUITLESS])
def test_searching_goes_on_for_as_long_as_something_better_was_found_not_long_ago(better_in):
    solver = solver_of(job("a", 1), job("b", 3))
    first = solver._draft.plan
    better = msgspec.structs.replace(first, cost_j=first.cost_j - 1.0)

    class Search:
        def plan(self, _, **fields):
            return better if fields["seed"] == 5 + better_in else first

    solver._search = Search()
    found = better_in < FRUITLESS
    assert sum(1 for _ in solver.improve()) == (better_in + 1 + FRUITLESS if found else FRUITLESS)
    assert solver._draft.plan is (better if found else first)
