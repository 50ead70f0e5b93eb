"""Elections: when a candidate has won, and by which number and since when."""

import pytest

from robrain.coordinator.leadership.election import Election, Won
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.messages.robots.witness_messages import ROBOT_WITNESS, WitnessRefusal, WitnessReply


def outcome(election: Election, clock: VirtualClock) -> Won | None:
    """The election that it wins within some seconds."""
    for _ in range(50):
        won = election.step(clock.now_ns(), is_copy=False)
        if won is not None:
            return won
        clock.advance_to(clock.now_ns() + to_ns(0.1))
    return None


@pytest.mark.parametrize(("before", "is_after_another"), [("", False), ("journal", False), ("other", True)])
def test_a_candidate_that_learns_of_a_later_election_stands_in_the_one_after_it(wire, before, is_after_another) -> None:
    names, asked = ("r1", "r2", "r3"), []

    def vote(request) -> WitnessReply:
        asked.append(request.asked.election)
        refusal = WitnessRefusal.OUTVOTED if asked[-1] <= 7 else None
        return WitnessReply(refusal=refusal, election=max(7, asked[-1]), before=before)

    for name in names:
        wire.answer(ROBOT_WITNESS, vote, robot=name)
    won = outcome(Election(wire, names, "journal"), wire.clock)
    assert asked == [1] * 3 + [8] * 3
    assert (won.election, won.is_after_another) == (8, is_after_another)


def test_half_of_the_witnesses_elect_nobody_and_a_lease_counts_from_the_vote_that_was_asked_for_first(wire) -> None:
    refusals = {"r2": WitnessRefusal.LEADER_SEEN}
    for name in ("r1", "r2"):
        wire.answer(ROBOT_WITNESS, lambda _, of=name: WitnessReply(refusal=refusals.get(of), election=1), robot=name)
    election = Election(wire, ("r1", "r2"), "journal")
    assert [election.step(0, is_copy=False) for _ in range(3)] == [None] * 3
    refusals.clear()
    assert outcome(election, wire.clock).asked_ns == 0 < wire.clock.now_ns()
