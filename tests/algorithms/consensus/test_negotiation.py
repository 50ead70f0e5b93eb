"""Negotiations: robots draw the same conclusions round by round, whatever is lost."""

import math
import random
from collections import Counter
from itertools import permutations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.consensus.bidder import Bidder
from robrain.algorithms.consensus.negotiation import Negotiation
from robrain.algorithms.consensus.route_scorer import DriveCost, RouteScorer, RouteStop
from tests.algorithms.allocation.instances import team_problem
from tests.bench.consensus import negotiate, scorer_of

PROBLEM = team_problem(4, 16, 3, tightness=0.75)


def members_of(rounds: int) -> list[Negotiation]:
    members = [Negotiation(worker.name, scorer_of(PROBLEM, worker), rounds) for worker in PROBLEM.workers]
    place = {job.id: job.place for job in PROBLEM.jobs}
    for member in members:
        member.open(
            1,
            [worker.name for worker in PROBLEM.workers],
            place,
            lambda one, other: float(PROBLEM.time_s[0][place[one], place[other]]),
        )
    return members


@pytest.mark.parametrize("loss", [0.0, 0.2, 0.5])
def test_all_robots_end_with_the_same_allocation_and_value(loss: float) -> None:
    members, rng = members_of(20), random.Random(1)
    for _ in range(2000):
        exchange(members, loss, rng)
        if all(member.is_over for member in members):
            break
    assert all(member.is_over for member in members)
    assert all(member.winners == members[0].winners for member in members)
    assert all(member.value == members[0].value for member in members)
    for member in members:
        mine = [task for task, robot in member.winners.items() if robot == member.bidder.robot]
        assert sorted(member.path) == sorted(mine)
    worth = sum(member.bidder.scorer.value(member.path) for member in members)
    assert worth == pytest.approx(members[0].value)


def test_nothing_is_agreed_while_a_robot_is_silent() -> None:
    members = members_of(0)[:-1]
    for _ in range(50):
        ballots = [member.ballot() for member in members]
        for member in members:
            for ballot in ballots:
                member.receive(ballot)
    assert not any(member.is_agreed for member in members)
    assert all(member.path == [] for member in members)


def test_a_ballot_of_a_later_negotiation_calls_for_a_new_one() -> None:
    here, there = members_of(0)[:2]
    there.open(2, ["r0", "r1"], [], lambda _one, _other: 0.0)
    assert not here.receive(there.ballot())
    assert there.receive(here.ballot())
    assert here.term == 1


@pytest.mark.slow
@pytest.mark.parametrize("seed", [12, 14])
def test_robots_do_not_outbid_each_other_for_ever(seed: int) -> None:
    """They did here while a path was only put in order once nothing more could be bid for."""
    told = negotiate(team_problem(5, 30, seed, tightness=0.75), 80, 0.0, seed)
    assert told is not None
    assert told.exchanges < 10 * 80


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


PRIZE_J = 1000.0
ROBOTS = 4
FIELD_TASKS = [f"t{number:02}" for number in range(16)]


class Field:
    """Tasks and robots at drawn places of a floor of 20 × 20 m."""

    def __init__(self, seed: int) -> None:
        rng = random.Random(seed)
        self.places = {name: (rng.uniform(0.0, 20.0), rng.uniform(0.0, 20.0)) for name in FIELD_TASKS}
        self.starts = [(rng.uniform(0.0, 20.0), rng.uniform(0.0, 20.0)) for _ in range(ROBOTS)]

    def apart(self, one: str, other: str) -> float:
        return math.dist(self.places[one], self.places[other])

    def members(self, rounds: int) -> list[Negotiation]:
        members = []
        names = [f"r{number}" for number in range(ROBOTS)]
        for name, start in zip(names, self.starts, strict=True):
            places = [*self.places.values(), start, (10.0, 10.0)]
            costs = [[math.dist(one, other) for other in places] for one in places]
            stops = {task: RouteStop(index, PRIZE_J) for index, task in enumerate(FIELD_TASKS)}
            scorer = RouteScorer(
                DriveCost(costs, costs, len(FIELD_TASKS), (len(FIELD_TASKS) + 1,), math.inf, counts_end=False),
                stops,
                noise=1.0,
            )
            member = Negotiation(name, scorer, rounds, while_working=True)
            member.bidder.limit = math.ceil(len(FIELD_TASKS) / ROBOTS)
            member.open(1, names, FIELD_TASKS, self.apart)
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
    assert sorted(task for member in members for task in member.path) == FIELD_TASKS


def test_nothing_may_begin_before_there_is_agreement() -> None:
    (member, *_) = Field(1).members(rounds=3)
    member.ballot()
    assert not any(member.may_begin(task) for task in FIELD_TASKS)


def with_charger(usable_j: float, *, counts_end: bool) -> RouteScorer:
    """A robot at 0 m that takes 1 J/m, a charger at 10 m, tasks at 2, 4 and 6 m."""
    places = [2.0, 4.0, 6.0, 0.0, 10.0]
    costs = [[abs(one - other) for other in places] for one in places]
    stops = {task: RouteStop(index, 100.0) for index, task in enumerate(("a", "b", "c"))}
    return RouteScorer(DriveCost(costs, costs, 3, (4,), usable_j, counts_end=counts_end), stops)


def test_the_way_to_a_charger_is_kept_in_reserve_whether_it_counts_or_not() -> None:
    assert with_charger(10.0, counts_end=True).cost_j(["a"]) == 10.0
    assert with_charger(10.0, counts_end=False).cost_j(["a"]) == 2.0
    for counts_end in (True, False):
        scorer = with_charger(9.0, counts_end=counts_end)
        assert scorer.cost_j(["a"]) == math.inf
        assert scorer.insertion([], "a") is None
        assert with_charger(10.0, counts_end=counts_end).insertion(["c"], "a") is not None
        assert with_charger(13.0, counts_end=counts_end).insertion(["a", "b"], "c") is not None


def test_a_shorter_order_that_leaves_too_little_for_the_way_to_the_charger_is_not_taken() -> None:
    scorer = with_charger(20.0, counts_end=False)
    assert scorer.ordered(["c", "b", "a"]) == ["a", "b", "c"]
    places = [1.0, -1.0, 0.0, 2.0]  # the order that ends away from the charger is no longer, and was given
    costs = [[abs(one - other) for other in places] for one in places]
    stops = {"a": RouteStop(0, 9.0), "b": RouteStop(1, 9.0)}
    tight = RouteScorer(DriveCost(costs, costs, 2, (3,), 5.0, counts_end=False), stops)
    assert tight.cost_j(["b", "a"]) == 3.0
    assert tight.cost_j(["a", "b"]) == math.inf
    assert tight.ordered(["b", "a"]) == ["b", "a"]


def test_the_first_tasks_of_a_path_stay_where_they_are() -> None:
    scorer = with_charger(math.inf, counts_end=False)
    scorer.keep_first(1)
    assert scorer.ordered(["c", "b", "a"])[0] == "c"
    found = scorer.insertion(["c"], "a")
    assert found is not None
    assert found.position == 1
    scorer.keep_first(0)
    assert scorer.ordered(["c", "b", "a"]) == ["a", "b", "c"]


def route_scorer(seed: int, tasks: int, usable_j: float = math.inf, latest_s: float = math.inf) -> RouteScorer:
    rng = random.Random(seed)
    places = [(rng.random() * 10, rng.random() * 10) for _ in range(tasks + 2)]
    costs = [[math.dist(one, other) for other in places] for one in places]
    stops = {
        f"t{index}": RouteStop(index, 20.0, service_s=1.0, service_j=0.5, latest_s=latest_s) for index in range(tasks)
    }
    return RouteScorer(DriveCost(costs, costs, tasks, (tasks, tasks + 1), usable_j), stops)


@given(st.integers(0, 10_000))
@settings(max_examples=50, deadline=None)
def test_gain_of_an_insertion_is_the_difference_of_the_routes(seed: int) -> None:
    scorer, path = route_scorer(seed, 6), ["t0", "t1", "t2", "t3"]
    found = scorer.insertion(path, "t5")
    assert found is not None
    longer = [*path[: found.position], "t5", *path[found.position :]]
    assert math.isclose(scorer.value(longer) - scorer.value(path), found.gain, abs_tol=1e-9)
    others = [scorer.value([*path[:at], "t5", *path[at:]]) for at in range(5)]
    assert math.isclose(max(others), scorer.value(longer), abs_tol=1e-9)


@given(st.integers(0, 10_000))
@settings(max_examples=50, deadline=None)
def test_no_move_and_no_reversal_shortens_an_ordered_path(seed: int) -> None:
    scorer, given_path = route_scorer(seed, 6), [f"t{index}" for index in range(6)]
    path = scorer.ordered(given_path)
    cost_j = scorer.cost_j(path)
    assert sorted(path) == given_path
    assert cost_j <= scorer.cost_j(given_path)
    for first, last in permutations(range(6), 2):
        rest = path[:first] + path[first + 1 :]
        assert scorer.cost_j([*rest[:last], path[first], *rest[last:]]) >= cost_j - 1e-6
        if first < last:
            turned = path[:first] + path[first : last + 1][::-1] + path[last + 1 :]
            assert scorer.cost_j(turned) >= cost_j - 1e-6


@given(st.integers(0, 10_000), st.floats(5.0, 40.0))
@settings(max_examples=50, deadline=None)
def test_a_route_that_does_not_reach_a_charger_is_never_made(seed: int, usable_j: float) -> None:
    scorer, path = route_scorer(seed, 5, usable_j), []
    for task in ("t0", "t1", "t2", "t3", "t4"):
        found = scorer.insertion(path, task)
        if found is not None:
            path.insert(found.position, task)
    assert scorer.cost_j(path) <= usable_j + 1e-6


def test_a_task_that_would_be_late_cannot_be_inserted() -> None:
    scorer = route_scorer(3, 4, latest_s=0.5)
    assert scorer.insertion([], "t0") is None


def test_a_task_that_the_robot_is_not_able_to_do_has_no_score() -> None:
    assert route_scorer(1, 2).insertion([], "elsewhere") is None
