"""The bundle algorithm: whatever happens to messages, all agree, and on what the greedy algorithm allocates."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.consensus.bidder import Bidder, action_for
from robrain.protocol.model.ballot import TASKS_MAX, Ballot, Bid
from tests.algorithms.consensus.teams import (
    Coverage,
    Post,
    agree,
    bidders_of,
    drawn_team,
    exchange,
    greedy,
    paths_of,
    settle,
    without_conflicts,
)

SEEDS = st.integers(0, 10_000)


@given(SEEDS, st.integers(1, 8), st.integers(1, 10))
@settings(max_examples=80, deadline=None)
def test_every_connected_team_agrees_within_tasks_times_diameter(seed: int, robots: int, tasks: int) -> None:
    team = drawn_team(seed, robots=robots, tasks=tasks)
    bidders = bidders_of(team)
    exchanges = settle(team, bidders)
    assert exchanges <= tasks * max(1, team.diameter) + 1
    assert agree(bidders)
    assert paths_of(bidders) == greedy(team)


@pytest.mark.slow
@given(SEEDS, SEEDS)
@settings(max_examples=20, deadline=None)
def test_the_result_is_the_same_whatever_the_order_of_late_and_repeated_messages(seed: int, order: int) -> None:
    team, rng = drawn_team(seed, robots=4, tasks=6), random.Random(order)
    bidders, post = bidders_of(team), Post(rng)
    names = list(bidders)
    for _ in range(400):
        rng.shuffle(names)
        for name in names:
            bidders[name].build()
            post.send(team, bidders[name].ballot())
            post.deliver(bidders)
    settle(team, bidders)
    assert agree(bidders)
    assert paths_of(bidders) == greedy(team)


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_tasks_of_a_robot_that_vanishes_go_to_those_who_stay(seed: int) -> None:
    team = drawn_team(seed, robots=4, tasks=6)
    names = sorted(team.scorers)
    everybody_hears = {(one, other) for one in names for other in names if one != other}
    team = team._replace(edges=everybody_hears)
    bidders = bidders_of(team)
    settle(team, bidders)
    gone = names[seed % 4]
    left = team._replace(
        scorers={name: scorer for name, scorer in team.scorers.items() if name != gone},
        edges={edge for edge in everybody_hears if gone not in edge},
    )
    remaining = {name: bidders[name] for name in left.scorers}
    for number, bidder in enumerate(remaining.values()):
        if number:  # one of them notices it later
            bidder.forget(gone)
    exchange(left, remaining)
    next(iter(remaining.values())).forget(gone)
    settle(left, remaining)
    assert agree(remaining)
    assert paths_of(remaining) == greedy(left)
    assert without_conflicts(remaining)


def test_an_old_or_repeated_ballot_changes_nothing() -> None:
    bidder = Bidder("a", Coverage({"t": frozenset((0,))}, [1.0]))
    bidder.open(["t"])
    first = Ballot(robot="b", number=1, bids=(Bid(task="t", robot="b", score=5.0),))
    second = Ballot(robot="b", number=2)
    assert bidder.receive(first)
    assert bidder.receive(second)
    assert not bidder.receive(first)
    assert not bidder.receive(second)
    assert bidder.winning == {}


def test_a_robot_bids_for_a_bounded_number_of_tasks() -> None:
    tasks = [f"t{number:04}" for number in range(TASKS_MAX + 50)]
    bidder = Bidder("a", Coverage(dict.fromkeys(tasks, frozenset((0,))), [1.0]))
    bidder.open(tasks)
    assert bidder.tasks == tasks[:TASKS_MAX]


HIGHER, LOWER = 9.0, 1.0


def bid(robot: str, score: float) -> Bid | None:
    return Bid(task="t", robot=robot, score=score) if robot else None


ROWS = [
    # sender's, receiver's, sender's bid is greater, sender knows more of, action
    ("k", "i", True, "", "update"),
    ("k", "i", False, "", "leave"),
    ("k", "k", False, "", "update"),
    ("k", "m", False, "m", "update"),
    ("k", "m", True, "", "update"),
    ("k", "m", False, "", "leave"),
    ("k", "", False, "", "update"),
    ("i", "i", True, "", "leave"),
    ("i", "k", True, "", "reset"),
    ("i", "m", False, "m", "reset"),
    ("i", "m", True, "", "leave"),
    ("i", "", True, "", "leave"),
    ("m", "i", True, "m", "update"),
    ("m", "i", False, "m", "leave"),
    ("m", "i", True, "", "leave"),
    ("m", "k", False, "m", "update"),
    ("m", "k", True, "", "reset"),
    ("m", "m", False, "m", "update"),
    ("m", "m", True, "", "leave"),
    ("m", "n", False, "mn", "update"),
    ("m", "n", True, "m", "update"),
    ("m", "n", False, "m", "leave"),
    ("m", "n", True, "n", "reset"),
    ("m", "n", True, "", "leave"),
    ("m", "", False, "m", "update"),
    ("m", "", True, "", "leave"),
    ("", "i", False, "", "leave"),
    ("", "k", False, "", "update"),
    ("", "m", False, "m", "update"),
    ("", "m", False, "", "leave"),
    ("", "", False, "", "leave"),
]


@pytest.mark.parametrize(("theirs", "mine", "is_greater", "newer", "action"), ROWS)
def test_action_is_that_of_the_table(theirs: str, mine: str, is_greater: bool, newer: str, action: str) -> None:
    received, known = bid(theirs, HIGHER if is_greater else LOWER), bid(mine, LOWER if is_greater else HIGHER)
    assert action_for("i", "k", known, received, lambda robot: robot in newer) == action


def test_of_equal_bids_that_of_the_lesser_name_counts_as_greater() -> None:
    assert action_for("i", "k", bid("i", 1.0), bid("k", 1.0), lambda _: False) == "leave"
    assert action_for("k", "i", bid("k", 1.0), bid("i", 1.0), lambda _: False) == "update"
