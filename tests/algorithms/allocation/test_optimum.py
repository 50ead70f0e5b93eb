"""Against the exact optimum by CP-SAT."""

import pytest

from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.algorithms.allocation.problem import Objective
from robrain.algorithms.allocation.validate import validate
from tests.algorithms.allocation.instances import team_problem
from tests.algorithms.allocation.oracle import exact_plan

SIZES = [(2, 8), (4, 8), (6, 6)]


def never():
    raise AssertionError("the clock is not read where only iterations count")


@pytest.mark.slow
@pytest.mark.parametrize(("robots", "tasks"), SIZES)
@pytest.mark.parametrize(
    "kind",
    [
        {"prize_j": None, "tightness": None},
        {"tightness": 0.9},
        {"tightness": 0.9, "windows": 0.4, "needs": 0.3, "late_start": 20.0},
    ],
    ids=["energy", "prizes", "windows and needs"],
)
def test_optimal_is_within_half_a_percent_of_the_exact_optimum(robots, tasks, kind):
    problem = team_problem(robots, tasks, 0, **kind)
    exact = exact_plan(problem)
    assert exact is not None
    assert validate(problem, exact) == []
    plan = OptimalAllocator(Objective.ENERGY, never).plan(problem, iterations=1000)
    # The oracle rounds to a millijoule a way: nobody is better by more.
    assert exact.value * (1 - 1e-5) <= plan.value <= exact.value * 1.005


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_better_than_the_exact_optimum_where_jobs_wait_for_each_other(seed):
    problem = team_problem(3, 7, seed, tightness=0.9, after=0.3, pairs=0.3)
    exact = exact_plan(problem)
    assert exact is not None
    assert validate(problem, exact) == []
    plan = OptimalAllocator(Objective.ENERGY, never).plan(problem, iterations=600)
    assert validate(problem, plan) == []
    assert exact.value * (1 - 1e-5) <= plan.value
