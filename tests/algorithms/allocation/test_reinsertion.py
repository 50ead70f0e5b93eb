"""Plans with a price of time: the search finds better ones than the auction, and all are feasible."""

import msgspec
import pytest

from robrain.algorithms.allocation.auction import AuctionAllocator
from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.algorithms.allocation.problem import Objective
from robrain.algorithms.allocation.validate import validate
from tests.algorithms.allocation.instances import team_problem
from tests.algorithms.allocation.test_validate import job, line, worker


def priced(problem, delay_w=10.0):
    jobs = tuple(msgspec.structs.replace(one, delay_w=delay_w) for one in problem.jobs)
    return msgspec.structs.replace(problem, jobs=jobs)


def searched(problem, iterations=50, seed=0):
    return OptimalAllocator(Objective.ENERGY, lambda: 0.0).plan(problem, iterations=iterations, seed=seed)


@pytest.mark.parametrize(
    ("features", "share"),
    [
        ({}, 0.95),
        ({"deliveries": 0.5}, 0.98),
        ({"after": 0.3, "pairs": 0.2}, 1.0),
        ({"windows": 0.4, "needs": 0.4, "wait_w": 1.0}, 1.0),
    ],
)
def test_search_finds_better_plans_than_the_auction(features, share):
    first_j = found_j = 0.0
    for seed in range(4):
        problem = priced(team_problem(4, 14, seed, tightness=None, prize_j=None, **features))
        first, found = AuctionAllocator(Objective.ENERGY).plan(problem), searched(problem)
        assert validate(problem, found) == []
        assert searched(problem) == found
        first_j, found_j = first_j + first.value, found_j + found.value
    assert found_j < share * first_j


def test_price_decides_between_few_paths_and_early_ends():
    problem = line([job(name, 1, service_s=5.0) for name in "ab"], [worker("r1"), worker("r2")])
    by_price = [sorted(map(len, searched(priced(problem, delay_w)).orders)) for delay_w in (0.0, 100.0)]
    assert by_price == [[0, 2], [1, 1]]


def test_job_that_ends_late_is_not_left_out_for_its_delay():
    problem = priced(line([job("a", 1, earliest_s=1e6)], [worker("r1")]))
    assert searched(problem).unassigned == ()
    long = priced(line([job(name, 1, service_s=1e4) for name in "abc"], [worker("r1")]))
    assert searched(long).unassigned == ()
