"""Rounds of a negotiation find what the greedy bundle misses: which robots are worth driving at all."""

import math

import pytest

from robrain.algorithms.consensus.bidder import Bidder
from robrain.algorithms.consensus.negotiation import Negotiation
from robrain.algorithms.consensus.route_scorer import FREE_START_SHARE, DriveCost, RouteScorer, RouteStop


def on_a_line(places_m: dict[str, float], start_m: float, end_m: float, prize_j: float) -> RouteScorer:
    """A robot that takes 1 J/m along a line, and tasks worth `prize_j` at places of it."""
    all_m = [*places_m.values(), start_m, end_m]
    costs = [[abs(one - other) for other in all_m] for one in all_m]
    stops = {task: RouteStop(index, prize_j) for index, task in enumerate(places_m)}
    return RouteScorer(DriveCost(costs, costs, len(places_m), (len(places_m) + 1,), math.inf), stops)


TASKS = {f"t{number}": 10.0 + number for number in range(6)}


def negotiated(scorers: dict[str, RouteScorer], rounds: int) -> list[Negotiation]:
    members = [Negotiation(robot, scorer, rounds) for robot, scorer in scorers.items()]
    for member in members:
        member.open(1, scorers, TASKS, lambda one, other: abs(TASKS[one] - TASKS[other]))
    for _ in range(50 * (rounds + 1)):
        ballots = [member.ballot() for member in members]
        for member in members:
            for ballot in ballots:
                if ballot.robot != member.bidder.robot:
                    member.receive(ballot)
        if all(member.is_over for member in members):
            return members
    raise AssertionError("expected the robots to agree")


def far() -> RouteScorer:
    """It drives 30 m to its charger, past tasks that are worth 8 J each: one is not worth it, six are."""
    return on_a_line(TASKS, 0.0, 30.0, prize_j=8.0)


def test_a_robot_begins_a_route_that_is_worth_it_for_several_tasks_and_for_no_single_one() -> None:
    (greedy,) = negotiated({"r1": far()}, rounds=0)
    assert greedy.path == []
    (improved,) = negotiated({"r1": far()}, rounds=40)
    assert sorted(improved.path) == sorted(TASKS)
    assert improved.value == pytest.approx(6 * 8.0 - 30.0)


def test_the_plain_score_counts_the_whole_way_and_some_variants_do_not() -> None:
    scorer = far()
    plain = scorer.insertion([], "t0")
    assert plain is not None
    assert plain.gain == 8.0 - 30.0
    free = 0
    for variant in range(1, 201):
        scorer.begin(variant)
        found = scorer.insertion([], "t0")
        assert found is not None
        free += found.gain > 0
    assert free == pytest.approx(200 * FREE_START_SHARE, abs=20)
    scorer.begin(0)
    assert scorer.insertion([], "t0") == plain


def test_the_energy_that_a_robot_has_bounds_a_route_whose_start_is_not_counted() -> None:
    places = [*TASKS.values(), 0.0, 30.0]
    costs = [[abs(one - other) for other in places] for one in places]
    stops = {task: RouteStop(index, 8.0) for index, task in enumerate(TASKS)}
    scorer = RouteScorer(DriveCost(costs, costs, 6, (7,), usable_j=29.0), stops)
    for variant in range(60):
        scorer.begin(variant)
        assert scorer.insertion([], "t0") is None


def test_a_robot_that_rests_bids_for_nothing_until_the_next_round() -> None:
    bidder = Bidder("r1", on_a_line(TASKS, 10.0, 10.0, prize_j=8.0))
    bidder.open(TASKS, rests=True)
    bidder.build()
    assert (bidder.bundle, bidder.ballot().bids) == ([], ())
    bidder.open(TASKS)
    bidder.build()
    assert sorted(bidder.path) == sorted(TASKS)


def test_the_limit_counts_the_tasks_that_are_fixed() -> None:
    bidder = Bidder("r1", on_a_line(TASKS, 10.0, 10.0, prize_j=8.0))
    bidder.limit = 3
    bidder.open(["t2", "t3", "t4"], fixed=["t0", "t1"])
    bidder.build()
    assert len(bidder.path) == 3
    bidder.open(["t4"], fixed=["t0", "t1", "t2", "t3"])
    bidder.build()
    assert bidder.bundle == []
