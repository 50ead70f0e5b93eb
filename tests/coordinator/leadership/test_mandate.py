"""What a coordinator that was elected may do while links are cut and processes are killed."""

from collections.abc import Iterator
from contextlib import closing, contextmanager

import msgspec
import pytest

from robrain.agent.consensus.witness import Kept, Witness, WitnessExtension
from robrain.algorithms.allocation.allocator import AUCTION
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.leadership.leadership import ElectedLeadership, JournalFeed
from robrain.coordinator.planning.policy import NEAREST
from robrain.lab.soak.fault_script import FaultScript, ScriptRobot
from robrain.lab.soak.operator import OPERATOR
from robrain.lab.soak.soak_run import CAPACITY_J, quiet
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.messages.robots.witness_messages import Lead, Led, WitnessRequest, WitnessWish
from robrain.protocol.messages.tasks.task_messages import TASK_SUBMIT, TaskSubmission
from robrain.protocol.messages.team.standing_messages import COORDINATOR_LEAD, JournalChanges, LeadRequest, StandByState
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.faults.fault_spec import COORDINATOR, FaultKind, FaultSpec
from tests.coordinator.leadership.elected_team import OTHER, ElectedRun
from tests.plain_reason import Plain

ROBOTS = ("r1", "r2", "r3")
NOT_NOW_S = 0.001
"""Of the wall: within this process a reply is there at once, or with a later step."""
FIRST, SECOND = "coordinator-1", "stand_by-2"
"""Journals: that of the first, and the copy of it."""


def kill(team: "Team", name: str, *, begins: bool = True) -> None:
    team.run.team_faults.set(500, FaultSpec(robot=name, kind=FaultKind.KILL, at_s=0.0), begins=begins)


class Team:
    """Three robots, a coordinator that leads, one that is in step, and an operator who submits visits."""

    def __init__(self, method: str = NEAREST) -> None:
        robots = tuple(
            ScriptRobot(name=name, place=Point2D(2.0 * number, 1.0), soc=1.0) for number, name in enumerate(ROBOTS)
        )
        script = FaultScript(
            seed=5, robots=robots, chargers=(Point2D(0.0, 0.0),), method=method, tasks=(), cancels=(), halts=(),
            consensus=False, faults=(),
        )  # fmt: skip
        self.run = ElectedRun(script, ())
        self._wire = self.run.wire_of(party=OPERATOR)
        self._faults = 0
        self.acknowledged: list[str] = []
        self.refused: dict[str, CallError] = {}
        self._waiting: set[str] = set()

    def pass_s(self, time_s: float) -> None:
        for _ in range(max(1, round(time_s / self.run.tick_s))):
            self.run.tick()
            assert len(self.run.leading()) < 2
            for name in sorted(self._waiting):
                self._ask(name)

    def submit(self, name: str, *, run_s: float = 0.0) -> None:
        """Ask, and in the next ticks again, until the task is acknowledged; then let this time pass."""
        self._ask(name)
        if run_s:
            self.pass_s(run_s)

    def _ask(self, name: str) -> None:
        self._waiting.add(name)
        asked = TaskSubmission(task=Task(id=name, kind="visit", place=Point2D(5.0, 5.0)))
        try:
            self._wire.ask(TASK_SUBMIT, asked, timeout_s=NOT_NOW_S)
        except (CallError, NobodyThere) as error:
            if isinstance(error, CallError):
                self.refused[name] = error
            return
        self._waiting.discard(name)
        self.acknowledged.append(name)

    @contextmanager
    def cut(self, *side: str) -> Iterator[None]:
        """Cut these components off from all others within the block."""
        self._faults += 1
        number, fault = (
            self._faults,
            FaultSpec(robot=side[0], kind=FaultKind.PARTITION, at_s=0.0, until_s=1.0, side=side[1:]),
        )
        self.run.team_faults.set(number, fault, begins=True)
        yield
        self.run.team_faults.set(number, fault, begins=False)

    def close(self) -> None:
        self.run.close()

    def mandate(self, site: str):
        return self.run.site(site).coordinator.part(ElectedLeadership).mandate

    def journals(self) -> list[set[str]]:
        """Names of journals that each robot remembers to have everything."""
        return [set(memory.read().holders) for memory in self.run.memories.values()]


@pytest.fixture
def team() -> Iterator[Team]:
    with quiet():
        team = Team()
        team.pass_s(6.0)
        assert team.run.leading() == [COORDINATOR]
        assert team.journals() == [{FIRST, SECOND}] * 3
        yield team
        team.close()


def test_the_witnesses_learn_that_it_goes_on_alone_before_anything_is_acknowledged(team: Team) -> None:
    with team.cut(OTHER):
        team.submit("t1")
        assert team.acknowledged == []
        team.pass_s(2.0)
        assert team.acknowledged == ["t1"]
        assert team.journals() == [{FIRST}] * 3


def test_one_that_is_cut_off_acknowledges_nothing_and_the_other_leads(team: Team) -> None:
    with team.cut(COORDINATOR, OPERATOR):
        team.submit("t1")
        team.pass_s(10.0)
        assert team.acknowledged == []
        assert team.refused["t1"].code in (ErrorCode.REFUSED, ErrorCode.FAILED)
        assert team.run.leading() == [OTHER]
        site = team.run.site(COORDINATOR)
        now_ns = team.run.now_ns
        assert team.mandate(COORDINATOR).refusal(now_ns) == Plain("not_leading", received=0, witnesses=3)
        assert team.mandate(OTHER).refusal(now_ns) is None
    team.pass_s(4.0)
    assert site.coordinator is None  # it stands by, and copies the other's journal
    assert team.acknowledged == ["t1"]
    assert team.run.leader.tasks.find("t1") is not None


def test_robots_that_are_switched_off_one_by_one_do_not_suspend_it(team: Team) -> None:
    for name in ("r1", "r2"):
        kill(team, name)
    team.pass_s(5.0)
    assert team.run.leading() == [COORDINATOR]
    team.submit("t1", run_s=1.0)
    assert team.acknowledged == ["t1"]


def test_without_its_stand_by_and_most_witnesses_it_does_not_lead_until_they_are_back(team: Team) -> None:
    with team.cut(COORDINATOR, "r1"):
        team.pass_s(1.0)
        with team.cut(OTHER, "r2"), team.cut(OTHER, "r3"):
            team.pass_s(4.0)
            assert team.run.leading() == []
    team.pass_s(6.0)
    assert len(team.run.leading()) == 1


def test_one_that_takes_over_listens_before_its_first_offer(team: Team) -> None:
    kill(team, COORDINATOR)
    while team.run.leading() != [OTHER]:
        team.pass_s(0.1)
    began_ns = team.run.now_ns
    assert team.mandate(OTHER).refusal(began_ns) is not None
    while team.mandate(OTHER).refusal(team.run.now_ns) is not None:
        team.pass_s(0.1)
    assert to_ns(1.8) <= team.run.now_ns - began_ns <= to_ns(2.4)


def test_the_loss_of_the_first_loses_nothing_that_was_acknowledged(team: Team) -> None:
    team.submit("t1", run_s=1.0)
    kill(team, COORDINATOR)
    team.pass_s(8.0)
    assert team.run.leading() == [OTHER]
    assert team.run.leader.tasks.find("t1") is not None
    team.submit("t2")  # by the second alone: the first lacks it
    team.pass_s(1.0)
    assert team.acknowledged == ["t1", "t2"]
    assert team.journals() == [{SECOND}] * 3


def witness(team: Team, robot: str = "r1") -> Witness:
    extension = team.run.host(robot).extensions["witness"]
    assert isinstance(extension, WitnessExtension)
    return extension


def test_a_witness_that_took_part_in_a_later_election_follows_again_soon(team: Team) -> None:
    """Nobody has won that: the coordinator is elected once more, with a greater number."""
    later = WitnessRequest(wish=WitnessWish.ELECT, election=9, journal="x", forced=True)
    assert witness(team).answer(later, team.run.now_ns + to_ns(3.0)).refusal is None
    team.pass_s(4.0)
    assert team.run.leading() == [COORDINATOR]
    mandate = team.mandate(COORDINATOR)
    assert mandate.lead(team.run.now_ns).election == 10
    assert mandate.confirmations(team.run.now_ns) == 3


def test_one_whose_witnesses_have_voted_in_a_later_election_does_not_lead_although_only_its_journal_counts(
    team: Team,
) -> None:
    later = WitnessRequest(wish=WitnessWish.ELECT, election=9, journal="x", forced=True)
    for name in ("r1", "r2"):
        assert witness(team, name).answer(later, team.run.now_ns + to_ns(3.0)).refusal is None
    team.pass_s(0.5)
    assert team.run.leading() == []


def test_a_stand_by_that_could_not_be_elected_is_not_depended_on(team: Team) -> None:
    kill(team, OTHER)
    team.pass_s(3.0)
    for name in ("r1", "r2"):
        kill(team, name)
    kill(team, OTHER, begins=False)
    team.pass_s(5.0)
    kill(team, OTHER)
    team.pass_s(5.0)
    team.submit("t1", run_s=1.0)
    assert team.acknowledged == ["t1"]
    assert team.run.leading() == [COORDINATOR]


def test_one_that_does_not_lead_sends_no_robot_to_charge() -> None:
    with quiet(), closing(Team(AUCTION)) as team:
        team.pass_s(6.0)
        with team.cut(COORDINATOR, OPERATOR, "r1"):
            team.pass_s(4.0)
            team.run.robots["r1"].energy_j = 0.15 * CAPACITY_J
            for _ in range(12):
                team.pass_s(0.5)
                assert team.run.site(COORDINATOR).coordinator.tasks.of_robot("r1") is None
        team.pass_s(6.0)
        assert team.run.leader.tasks.of_robot("r1") is not None


def test_one_that_robots_do_not_hear_stops_before_its_stand_by_may_be_elected(team: Team) -> None:
    """While the stand-by follows it, it leads without them; they are long ready to elect another one."""
    faults = team.run.team_faults.wire
    passes, is_apart = faults.delay_ns, False

    def delay_ns(sender: str, receiver: str) -> int | None:
        pair = {sender, receiver}
        is_cut = COORDINATOR in pair and (bool(pair & set(ROBOTS)) or (is_apart and OTHER in pair))
        return None if is_cut else passes(sender, receiver)

    faults.delay_ns = delay_ns
    team.run.team_faults.set(1, FaultSpec(robot="unused", kind=FaultKind.LOSE, at_s=0.0, share=0.5), begins=True)
    team.pass_s(5.0)
    assert team.run.leading() == [COORDINATOR]
    is_apart = True
    team.pass_s(5.0)  # at no time do both lead
    assert team.run.leading() == [OTHER]


def test_a_witness_with_an_absurd_number_is_left_alone(team: Team) -> None:
    absurd = WitnessRequest(wish=WitnessWish.ELECT, election=10**15, journal="x", forced=True)
    assert team.run.host("r1").extensions["witness"].answer(absurd, team.run.now_ns + to_ns(3.0)).refusal is None
    with team.cut(OTHER):
        team.pass_s(3.0)
        team.submit("t1", run_s=2.0)
        assert team.acknowledged == ["t1"]
    kill(team, COORDINATOR)
    kill(team, COORDINATOR, begins=False)
    team.pass_s(8.0)
    (leader,) = team.run.leading()
    assert team.mandate(leader).lead(team.run.now_ns).election < 10


def test_a_witness_that_could_not_store_its_answer_is_asked_again(team: Team) -> None:
    def refuse(_kept: Kept) -> None:
        raise OSError("no space left")

    writes = {name: memory.write for name, memory in team.run.memories.items()}
    for memory in team.run.memories.values():
        memory.write = refuse
    with team.cut(OTHER):
        team.pass_s(3.0)
        team.submit("t1", run_s=1.0)
        assert team.acknowledged == []
        for name, memory in team.run.memories.items():
            memory.write = writes[name]
        team.pass_s(2.0)
        assert team.acknowledged == ["t1"]


def lose(team: Team, *names: str) -> None:
    """These are killed, and nobody leads any more."""
    for name in names:
        kill(team, name)
    team.pass_s(8.0)
    assert team.run.leading() == []


def lead_by_word(team: Team) -> list[str]:
    return team._wire.ask(COORDINATOR_LEAD, LeadRequest(by="ann")).skipped


def test_by_the_operators_word_one_leads_whose_journal_may_lack_something(team: Team) -> None:
    with team.cut(OTHER):
        team.pass_s(2.0)
        team.submit("t1", run_s=1.0)
        assert team.journals() == [{FIRST}] * 3
    kill(team, COORDINATOR)
    team.pass_s(8.0)
    assert team.run.leading() == []
    assert lead_by_word(team) == []
    team.pass_s(5.0)
    assert team.run.leading() == [OTHER]
    assert team.journals() == [{SECOND}] * 3


def test_by_the_operators_word_one_leads_without_witnesses_which_count_again_once_they_are_back(
    team: Team,
) -> None:
    lose(team, COORDINATOR, "r2", "r3")
    assert lead_by_word(team) == ["r2", "r3"]
    team.pass_s(5.0)
    assert team.run.leading() == [OTHER]
    team.submit("t1", run_s=1.0)
    assert team.acknowledged == ["t1"]
    assert team.journals()[0] == {SECOND}
    for name in ("r2", "r3"):
        kill(team, name, begins=False)
    team.pass_s(5.0)
    assert team.run.leading() == [OTHER]
    assert team.journals() == [{SECOND}] * 3
    assert team.mandate(OTHER)._election.voters == ROBOTS
    kill(team, COORDINATOR, begins=False)
    team.pass_s(4.0)
    assert team.run.leading() == [OTHER]


def test_by_the_operators_word_one_that_lost_its_witnesses_leads_again(team: Team) -> None:
    lose(team, OTHER, "r2", "r3")
    assert lead_by_word(team) == ["r2", "r3"]
    team.pass_s(4.0)
    assert team.run.leading() == [COORDINATOR]


def test_while_one_leads_the_operators_word_changes_nothing(team: Team) -> None:
    assert lead_by_word(team) == []
    team.pass_s(4.0)
    assert team.run.leading() == [COORDINATOR]
    assert team.mandate(COORDINATOR).lead(team.run.now_ns).election == 1


def test_nothing_is_followed_while_witnesses_may_be_electing_it(team: Team) -> None:
    """What it has written by then it has; what it writes later might be acknowledged because of it."""
    candidate = team.run.site(OTHER).candidate
    suspended = msgspec.structs.replace(team.mandate(COORDINATOR).lead(team.run.now_ns), is_suspended=True)
    said = JournalChanges(term=candidate._term, last=0, lead=suspended)
    assert candidate._is_followed(said, team.run.now_ns)
    candidate.election.step(team.run.now_ns, is_copy=True)
    assert candidate.election.is_asking
    assert not candidate._is_followed(said, team.run.now_ns)


def test_one_with_other_witnesses_neither_follows_nor_stands(team: Team) -> None:
    candidate = team.run.site(OTHER).candidate
    candidate.election.witnesses = ("r1", "r2")
    team.pass_s(3.0)
    assert candidate.unlike == "the coordinator that is heard has other witnesses: r1, r2, r3"
    assert team.run.leader.part(ElectedLeadership).feed.status().why == candidate.unlike
    assert team.journals() == [{FIRST}] * 3
    kill(team, COORDINATOR)
    team.pass_s(6.0)
    assert team.run.leading() == []


def test_a_copied_file_gets_another_name_once_the_other_is_heard(team: Team) -> None:
    """Under one name both could be elected."""
    site = team.run.site(OTHER)
    site._journal._db.execute("UPDATE standing SET name = ?", (FIRST,))
    site.candidate.election.journal = FIRST
    team.pass_s(3.0)
    assert site.candidate.election.journal not in ("", FIRST)
    assert team.run.leading() == [COORDINATOR]
    team.pass_s(3.0)
    assert team.journals() == [{FIRST, site.candidate.election.journal}] * 3


class Undecided:
    """A mandate of a coordinator whose witnesses have not answered."""

    def may_acknowledge(self, copy: str) -> bool:
        return False

    def record_copy(self, journal: str, led: Led) -> None:
        pass

    def lead(self, now_ns: int) -> Lead:
        return Lead(election=1, journal="a")


def test_a_change_on_both_disks_is_not_acknowledged_while_a_third_journal_may_be_elected() -> None:
    clock = VirtualClock()
    wire = Endpoint(open_lockstep_session(), DEFAULT_TEAM, clock, Drive.LOCKSTEP)
    journal = Journal()
    feed = JournalFeed(wire, journal, term=7, mandate=Undecided())
    said = StandByState(process="p", term=7, on_disk=0, journal="b", led=Led(election=1, stamp_ns=0))
    feed.receive(said, 0)
    assert feed.stand_by == "p"
    kept, lost = [], []
    feed.when_kept(lambda: kept.append(1), lost.append)
    feed.receive(said, 0)
    feed.step(0)
    assert (kept, lost) == ([], [])
    clock.advance_to(to_ns(3.0))
    feed.step(to_ns(3.0))
    assert (kept, len(lost)) == ([], 1)
    wire.close()
    journal.close()
