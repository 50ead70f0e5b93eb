"""How the search is steered: by what the auction took, and by what a model of the problem will take."""

import pytest

from robrain.algorithms.allocation.auction import GREATEST_GAIN, LEAST_BID, LEAST_PER_PRIZE, AuctionAllocator
from robrain.algorithms.allocation.insertion import BY_ENERGY
from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.algorithms.allocation.problem import Job, Objective, Worker
from tests.algorithms.allocation.test_validate import job, line, worker


def test_other_times_are_drawn_as_long_as_there_is_time_for_two_auctions(monkeypatch):
    """Only auctions move the clock; the first plan takes three of them."""
    hold = AuctionAllocator.hold
    now_s = 0.0
    drawn_at_s = []

    def hold_for_a_second(self, problem, rule, choice, rng=None):
        nonlocal now_s
        if rng is not None:
            drawn_at_s.append(now_s)
        now_s += 1.0
        return hold(self, problem, rule, choice, rng)

    monkeypatch.setattr(AuctionAllocator, "hold", hold_for_a_second)
    problem = line([job("a", 1), job("b", 2, after=("a",))], [worker("r1")])
    OptimalAllocator(Objective.ENERGY, lambda: now_s).plan(problem, deadline_s=3.0 + 7.5)
    # 7.5 s and 6.5 s are left, more than two times three; 5.5 s are less.
    assert drawn_at_s == [3.0, 4.0]


@pytest.mark.parametrize(("choice", "taken"), [(LEAST_BID, "near"), (GREATEST_GAIN, "dear"), (LEAST_PER_PRIZE, "dear")])
def test_auction_chooses_by_bid_by_gain_or_by_bid_for_its_prize(choice, taken):
    jobs = [Job(id="near", place=3, prize_j=5.0), Job(id="dear", place=0, prize_j=100.0)]
    problem = line(jobs, [Worker(name="r1", start=2, ends=(2,), usable_j=5.5)])
    plan, _ = AuctionAllocator().hold(problem, BY_ENERGY, choice)
    assert [stop.job for route in plan.routes for stop in route.stops] == [taken]


@pytest.mark.parametrize("choice", [LEAST_BID, GREATEST_GAIN, LEAST_PER_PRIZE])
def test_of_jobs_that_are_equally_good_the_auction_hands_out_the_first(choice):
    jobs = [job(name, 3, service_j=1.0) for name in ("first", "second", "third")]
    plan, _ = AuctionAllocator().hold(line(jobs, [worker("r1", usable_j=7.0)]), BY_ENERGY, choice)
    assert plan.orders == (("first",),)
