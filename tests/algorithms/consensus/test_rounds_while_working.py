"""Rounds of improvement while robots already work: what one has begun it keeps, whatever is lost."""

import math
import random
from collections import Counter

import pytest

from robrain.algorithms.consensus.negotiation import Negotiation
from robrain.algorithms.consensus.route_scorer import DriveCost, RouteScorer, RouteStop

PRIZE_J = 1000.0
ROBOTS = 4
TASKS = [f"t{number:02}" for number in range(16)]


class Field:
    """Tasks and robots at drawn places of a floor of 20 × 20 m."""

    def __init__(self, seed: int) -> None:
        rng = random.Random(seed)
        self.places = {name: (rng.uniform(0.0, 20.0), rng.uniform(0.0, 20.0)) for name in TASKS}
        self.starts = [(rng.uniform(0.0, 20.0), rng.uniform(0.0, 20.0)) for _ in range(ROBOTS)]

    def apart(self, one: str, other: str) -> float:
        return math.dist(self.places[one], self.places[other])

    def members(self, rounds: int) -> list[Negotiation]:
        members = []
        names = [f"r{number}" for number in range(ROBOTS)]
        for name, start in zip(names, self.starts, strict=True):
            places = [*self.places.values(), start, (10.0, 10.0)]
            costs = [[math.dist(one, other) for other in places] for one in places]
            stops = {task: RouteStop(index, PRIZE_J) for index, task in enumerate(TASKS)}
            scorer = RouteScorer(
                DriveCost(costs, costs, len(TASKS), (len(TASKS) + 1,), math.inf, counts_end=False), stops, noise=1.0
            )
            member = Negotiation(name, scorer, rounds, while_working=True)
            member.bidder.limit = math.ceil(len(TASKS) / ROBOTS)
            member.open(1, names, TASKS, self.apart)
            members.append(member)
        return members


def exchange(members: list[Negotiation], loss: float, rng: random.Random) -> None:
    ballots = [member.ballot() for member in members]
    for member in members:
        for ballot in ballots:
            if ballot.robot != member.bidder.robot and rng.random() >= loss:
                assert member.receive(ballot)


def work(members: list[Negotiation], loss: float, seed: int, share: float = 0.1) -> Counter[str]:
    """Have each robot begin its next task at drawn moments, until the negotiation is over; how often each was begun."""
    rng = random.Random(seed)
    begun = Counter[str]()
    for _ in range(3000):
        exchange(members, loss, rng)
        for member in members:
            mine = [task for task in member.path if task not in member.bidder.begun]
            if mine and rng.random() < share and member.may_begin(mine[0]):
                member.begin(mine[0])
                begun[mine[0]] += 1
        if all(member.is_over for member in members):
            return begun
    raise AssertionError("expected the robots to agree")


@pytest.mark.parametrize("loss", [0.0, 0.2, 0.5])
@pytest.mark.parametrize("seed", range(6))
def test_no_task_is_begun_twice_and_each_stays_with_the_robot_that_has_begun_it(seed: int, loss: float) -> None:
    members = Field(seed).members(rounds=20)
    begun = work(members, loss, seed)
    assert len(begun) > ROBOTS
    assert set(begun.values()) == {1}
    assert all(member.winners == members[0].winners for member in members)
    for member in members:
        assert member.bidder.path[: len(member.bidder.begun)] == member.bidder.begun
        assert all(members[0].winners[task] == member.bidder.robot for task in member.bidder.begun)
    assert sorted(task for member in members for task in member.path) == TASKS


@pytest.mark.slow
def test_rounds_shorten_the_ways_that_are_not_begun() -> None:
    costs = []
    for rounds in (0, 20):
        total = 0.0
        for seed in range(6):
            members = Field(seed).members(rounds)
            work(members, 0.2, seed, share=0.02)
            total += sum(member.bidder.scorer.cost_j(member.path) for member in members)
        costs.append(total)
    assert costs[1] < 0.95 * costs[0]


def test_a_task_that_the_robot_has_said_to_be_anothers_is_not_begun_before_the_round_has_ended() -> None:
    members, rng = Field(1).members(rounds=30), random.Random(1)
    kept_waiting = 0
    for _ in range(3000):
        exchange(members, 0.0, rng)
        for member in members:
            for task in member.path:
                said = [agreed.winners.get(task) for agreed in member._published.values()]
                assert member.may_begin(task) == all(robot == member.bidder.robot for robot in said)
                kept_waiting += not member.may_begin(task)
        if all(member.is_over for member in members):
            break
    assert kept_waiting > 0
    assert all(member.may_begin(task) for member in members for task in member.path)


def test_nothing_may_begin_before_there_is_agreement() -> None:
    (member, *_) = Field(1).members(rounds=3)
    member.ballot()
    assert not any(member.may_begin(task) for task in TASKS)


def test_what_was_begun_is_forgotten_with_a_new_negotiation() -> None:
    members = Field(2).members(rounds=3)
    work(members, 0.0, 1)
    member = next(one for one in members if one.bidder.begun)
    member.open(2, ["r0"], TASKS, lambda _one, _other: 0.0)
    assert member.bidder.begun == []


def on_a_line(usable_j: float, *, counts_end: bool) -> RouteScorer:
    """A robot at 0 m that takes 1 J/m, a charger at 10 m, tasks at 2, 4 and 6 m."""
    places = [2.0, 4.0, 6.0, 0.0, 10.0]
    costs = [[abs(one - other) for other in places] for one in places]
    stops = {task: RouteStop(index, 100.0) for index, task in enumerate(("a", "b", "c"))}
    return RouteScorer(DriveCost(costs, costs, 3, (4,), usable_j, counts_end=counts_end), stops)


def test_the_way_to_a_charger_is_kept_in_reserve_whether_it_counts_or_not() -> None:
    assert on_a_line(10.0, counts_end=True).cost_j(["a"]) == 10.0
    assert on_a_line(10.0, counts_end=False).cost_j(["a"]) == 2.0
    for counts_end in (True, False):
        scorer = on_a_line(9.0, counts_end=counts_end)
        assert scorer.cost_j(["a"]) == math.inf
        assert scorer.insertion([], "a") is None
        assert on_a_line(10.0, counts_end=counts_end).insertion(["c"], "a") is not None
        assert on_a_line(13.0, counts_end=counts_end).insertion(["a", "b"], "c") is not None


def test_a_shorter_order_that_leaves_too_little_for_the_way_to_the_charger_is_not_taken() -> None:
    scorer = on_a_line(20.0, counts_end=False)
    assert scorer.ordered(["c", "b", "a"]) == ["a", "b", "c"]
    places = [1.0, -1.0, 0.0, 2.0]  # the order that ends away from the charger is no longer, and was given
    costs = [[abs(one - other) for other in places] for one in places]
    stops = {"a": RouteStop(0, 9.0), "b": RouteStop(1, 9.0)}
    tight = RouteScorer(DriveCost(costs, costs, 2, (3,), 5.0, counts_end=False), stops)
    assert tight.cost_j(["b", "a"]) == 3.0
    assert tight.cost_j(["a", "b"]) == math.inf
    assert tight.ordered(["b", "a"]) == ["b", "a"]


def test_the_first_tasks_of_a_path_stay_where_they_are() -> None:
    scorer = on_a_line(math.inf, counts_end=False)
    scorer.keep_first(1)
    assert scorer.ordered(["c", "b", "a"])[0] == "c"
    found = scorer.insertion(["c"], "a")
    assert found is not None
    assert found.position == 1
    scorer.keep_first(0)
    assert scorer.ordered(["c", "b", "a"]) == ["a", "b", "c"]
