"""Negotiations: robots draw the same conclusions round by round, whatever is lost."""

import random

import pytest

from robrain.algorithms.consensus.negotiation import Negotiation
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
        ballots = [member.ballot() for member in members]
        for member in members:
            for ballot in ballots:
                if ballot.robot != member.bidder.robot and rng.random() >= loss:
                    assert member.receive(ballot)
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
