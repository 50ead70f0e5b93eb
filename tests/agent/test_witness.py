"""A robot as a witness: it elects one coordinator at a time, and none that lacks what was acknowledged."""

import pytest

from robrain.agent.consensus.witness import SILENT_NS, Kept, Witness, WitnessInMemory
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.witness_messages import Lead, Led, WitnessRefusal, WitnessRequest, WitnessWish
from robrain.protocol.messages.team.team_messages import TeamState

START_NS = to_ns(100.0)
LATER_NS = START_NS + SILENT_NS + 1
"""It has been silent around the robot for long enough."""


def elect(number: int, journal: str = "a", *, is_copy: bool = False, forced: bool = False, began_ns: int = 1):
    return WitnessRequest(
        wish=WitnessWish.ELECT, election=number, journal=journal, began_ns=began_ns, is_copy=is_copy, forced=forced
    )


def hold(election: int, number: int, *holders: str, journal: str = "a") -> WitnessRequest:
    return WitnessRequest(
        wish=WitnessWish.HOLD, election=election, journal=journal, number=number, holders=list(holders)
    )


def summary(election: int, journal: str = "a", *, is_suspended: bool = False, stamp_ns: int = 7) -> TeamState:
    lead = Lead(election=election, journal=journal, is_suspended=is_suspended)
    return TeamState(robots=[], lead=lead, stamp_ns=stamp_ns)


@pytest.fixture
def memory() -> WitnessInMemory:
    return WitnessInMemory()


@pytest.fixture
def witness(memory: WitnessInMemory) -> Witness:
    return Witness(memory, START_NS)


def test_it_elects_one_coordinator_in_an_election(witness: Witness) -> None:
    assert witness.answer(elect(1), LATER_NS).refusal is None
    assert witness.answer(elect(1), LATER_NS).refusal is None  # its first answer was lost
    assert witness.answer(elect(1, "b"), LATER_NS).refusal is WitnessRefusal.OUTVOTED
    other = witness.answer(elect(1, began_ns=2), LATER_NS)  # the same journal after a restart
    assert other.refusal is WitnessRefusal.OUTVOTED
    assert other.election == 1


def test_a_coordinator_that_was_heard_or_elected_just_before_is_not_voted_out(witness: Witness) -> None:
    assert witness.answer(elect(1), START_NS).refusal is WitnessRefusal.LEADER_SEEN  # perhaps before it started
    assert witness.answer(elect(1), LATER_NS).refusal is None
    now_ns = LATER_NS + SILENT_NS
    assert witness.answer(elect(2, "b"), now_ns).refusal is WitnessRefusal.LEADER_SEEN
    assert witness.receive_summary(summary(1), now_ns)
    now_ns += SILENT_NS
    assert witness.answer(elect(2, "b"), now_ns).refusal is WitnessRefusal.LEADER_SEEN
    assert witness.answer(elect(2, "b"), now_ns + 1).refusal is None


def test_the_one_that_leads_may_be_elected_again_at_once(witness: Witness) -> None:
    witness.answer(elect(1), LATER_NS)
    witness.receive_summary(summary(1), LATER_NS)
    assert witness.answer(elect(2), LATER_NS).refusal is None


def test_none_is_elected_with_a_journal_that_may_lack_something(witness: Witness) -> None:
    witness.answer(elect(1), LATER_NS)
    assert witness.answer(hold(1, 1, "a", "b"), LATER_NS).refusal is None
    now_ns = LATER_NS + SILENT_NS + 1
    assert witness.answer(elect(2, "c"), now_ns).refusal is WitnessRefusal.LACKS_CHANGES
    assert witness.answer(elect(2, "b", is_copy=True), now_ns).refusal is None


def test_a_copy_is_not_elected_by_one_that_was_never_told_who_has_everything(witness: Witness) -> None:
    assert witness.answer(elect(1, is_copy=True), LATER_NS).refusal is WitnessRefusal.LACKS_CHANGES
    assert witness.answer(elect(1), LATER_NS).refusal is None


def test_an_operators_word_elects_whatever_it_remembers(witness: Witness, memory: WitnessInMemory) -> None:
    witness.answer(elect(1), LATER_NS)
    witness.answer(hold(1, 1, "a"), LATER_NS)
    assert witness.answer(elect(2, "z", forced=True), LATER_NS).refusal is WitnessRefusal.LEADER_SEEN
    now_ns = LATER_NS + SILENT_NS + 1
    assert witness.answer(elect(2, "z"), now_ns).refusal is WitnessRefusal.LACKS_CHANGES
    assert witness.answer(elect(2, "z", forced=True), now_ns).refusal is None
    assert memory.read().holders == ["z"]
    assert witness.answer(elect(2, "y", forced=True), now_ns).refusal is WitnessRefusal.OUTVOTED


def test_late_wishes_to_hold_change_nothing(witness: Witness, memory: WitnessInMemory) -> None:
    witness.answer(elect(3), LATER_NS)
    witness.answer(hold(3, 5, "a"), LATER_NS)
    assert witness.answer(hold(3, 4, "a", "b"), LATER_NS).refusal is WitnessRefusal.OUTVOTED
    assert witness.answer(hold(2, 9, "a", "b"), LATER_NS).refusal is WitnessRefusal.OUTVOTED
    assert memory.read().holders == ["a"]
    assert witness.answer(hold(3, 6, "a", "b"), LATER_NS).refusal is None


def test_one_that_missed_the_election_believes_the_winner(witness: Witness, memory: WitnessInMemory) -> None:
    witness.answer(elect(1, "b"), LATER_NS)
    assert witness.answer(hold(1, 1, "a"), LATER_NS).refusal is None  # the others have elected a
    assert witness.answer(hold(4, 1, "a"), LATER_NS).refusal is None
    kept = memory.read()
    assert (kept.election, kept.journal, kept.before, kept.holders) == (4, "a", "b", ["a"])


def test_it_remembers_over_a_restart(witness: Witness, memory: WitnessInMemory) -> None:
    witness.answer(elect(4), LATER_NS)
    witness.answer(hold(4, 2, "a"), LATER_NS)
    again = Witness(memory, LATER_NS)
    now_ns = LATER_NS + SILENT_NS + 1
    assert again.answer(elect(4, "b"), now_ns).refusal is WitnessRefusal.OUTVOTED
    assert again.answer(elect(5, "b"), now_ns).refusal is WitnessRefusal.LACKS_CHANGES
    assert again.answer(elect(5, began_ns=2), LATER_NS).refusal is WitnessRefusal.LEADER_SEEN
    assert again.answer(elect(5, began_ns=2), now_ns).before == ""


def test_it_follows_no_coordinator_that_was_replaced_or_is_suspended(witness: Witness) -> None:
    assert witness.follows(TeamState(robots=[]))  # of a team without elections
    assert witness.receive_summary(summary(2, stamp_ns=70), LATER_NS)
    assert witness.led == Led(election=2, stamp_ns=70)
    assert not witness.receive_summary(summary(1), LATER_NS)
    assert not witness.receive_summary(summary(2, is_suspended=True, stamp_ns=80), LATER_NS)
    assert witness.led == Led(election=2, stamp_ns=70)
    now_ns = LATER_NS + SILENT_NS + 1
    assert witness.answer(elect(3, "b"), now_ns).refusal is None
    assert not witness.receive_summary(summary(2), now_ns)
    assert witness.led == Led(election=3, stamp_ns=0)  # elected, and not heard yet


def test_nobody_else_is_elected_with_the_number_by_which_a_coordinator_leads_that_it_has_not_elected(
    witness: Witness,
) -> None:
    assert witness.receive_summary(summary(5), LATER_NS)
    now_ns = LATER_NS + SILENT_NS + 1
    assert witness.answer(elect(5, "b"), now_ns).refusal is WitnessRefusal.OUTVOTED
    assert witness.answer(elect(6, "b"), now_ns).refusal is None


def test_a_suspended_coordinator_can_be_voted_out(witness: Witness) -> None:
    witness.answer(elect(1), LATER_NS)
    now_ns = LATER_NS + SILENT_NS + 1
    witness.receive_summary(summary(1, is_suspended=True), now_ns)
    assert witness.answer(elect(2, "b"), now_ns).refusal is None


class Broken:
    """A disk that cannot be read, or not be written."""

    def __init__(self, *, reads: bool) -> None:
        self.reads = reads

    def read(self) -> Kept:
        if not self.reads:
            raise ValueError("it is no JSON")
        return Kept(election=1, journal="a")

    def write(self, kept: Kept) -> None:
        raise OSError("no space left")


@pytest.mark.parametrize("reads", [True, False])
def test_it_elects_nobody_if_it_could_forget_that(reads: bool) -> None:
    witness = Witness(Broken(reads=reads), START_NS)
    assert witness.answer(elect(2), LATER_NS).refusal is WitnessRefusal.UNWRITABLE
    assert witness.answer(hold(2, 1, "a"), LATER_NS).refusal is WitnessRefusal.UNWRITABLE
    assert witness.answer(elect(3, "b"), LATER_NS).refusal is WitnessRefusal.UNWRITABLE


def test_one_that_stood_still_may_have_missed_a_coordinator(witness: Witness) -> None:
    witness.receive_summary(summary(1), LATER_NS)
    now_ns = LATER_NS + to_ns(3600.0)
    witness.restart_silence(now_ns)
    assert witness.answer(elect(2, "b"), now_ns).refusal is WitnessRefusal.LEADER_SEEN
    assert witness.answer(elect(2, "b"), now_ns + SILENT_NS + 1).refusal is None
