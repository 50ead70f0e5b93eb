"""A copied journal: nothing acknowledged is missing in it, whatever the wire does to the changes."""

from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.agent.consensus.witness import Witness, WitnessInMemory
from robrain.coordinator.coordinator import Coordinator
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.leadership.candidate import Candidate, Following
from robrain.coordinator.leadership.election import Elected, Election, Won
from robrain.coordinator.leadership.leadership import ElectedLeadership, JournalFeed
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.links.exchange import EVERYWHERE, Exchange
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.witness_messages import ROBOT_WITNESS, Lead
from robrain.protocol.messages.tasks import task_messages
from robrain.protocol.messages.tasks.task_messages import TaskFilter, TaskSubmission
from robrain.protocol.messages.team.standing_messages import KnownRobot
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, RobotSummary, TeamState
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.faults.fault_spec import COORDINATOR, FaultKind, FaultSpec
from robrain.sim.faults.process import JournalDisk
from robrain.sim.faults.wire_faults import WireFaults

shared_session = cache(open_lockstep_session)


ALL = TaskFilter(own=True, limit=10_000)
OTHER, WITNESS = "stand_by", "r1"
TICK_S = 0.05
NOT_NOW_S = 0.001
"""Of the wall: within this process a reply is there at once, or with a later step."""


class Pair:
    """A coordinator that one robot has elected, and a candidate, on a wire with faults."""

    def __init__(self, seed: int = 1, path=None) -> None:
        self.clock = VirtualClock()
        self.clock.advance_to(to_ns(100.0))
        self.faults = WireFaults(seed)
        self.exchange = Exchange(is_alone=True, network=self.faults, clock=self.clock, lost_after_s=2.0)
        self.exchange.serve(shared_session())
        self.disk, self.other_disk = JournalDisk(), JournalDisk("other")
        self.witness, self.summaries, robot = Witness(WitnessInMemory(), self.clock.now_ns()), Inbox(), self.endpoint()
        robot.answer(
            ROBOT_WITNESS, lambda request: self.witness.answer(request.asked, self.clock.now_ns()), robot=WITNESS
        )
        robot.subscribe(self.summaries, COORDINATOR_STATE)
        self.elections = 0
        self.begin()
        self.copy = self.other_disk.open() if path is None else Journal(path)
        self.candidate: Candidate | None = None
        self.asker = self.endpoint()
        self.acknowledged: list[str] = []
        self.waiting: list[str] = []

    def endpoint(self, party: str = EVERYWHERE) -> Endpoint:
        return Endpoint(shared_session(), DEFAULT_TEAM, self.clock, Drive.LOCKSTEP, party=party)

    def begin(self) -> None:
        """Start the coordinator on its journal."""
        self.elections += 1
        self.journal = self.disk.open()
        won = Won(self.elections, self.clock.now_ns(), is_after_another=False)
        elected = Elected((WITNESS,), (WITNESS,), self.journal.name, won)
        self.coordinator = Coordinator(self.endpoint(COORDINATOR), self.journal, elected=elected)
        self.coordinator.step()

    def join(self, time_s: float = 1.0) -> None:
        """A candidate follows, for this time."""
        wire = self.endpoint(OTHER)
        self.candidate = Candidate(wire, self.copy, OTHER, Election(wire, (WITNESS,), self.copy.name))
        self.run(time_s)

    def run(self, time_s: float) -> None:
        for _ in range(round(time_s / TICK_S)):
            self.clock.advance_to(self.clock.now_ns() + to_ns(TICK_S))
            self.exchange.step()
            self.coordinator.step()
            for received in self.summaries.drain():
                self.witness.receive_summary(received.message, self.clock.now_ns())
            if self.candidate is not None:
                self.candidate.step()
            self.waiting = [name for name in self.waiting if not self.submit(name)]

    def submit(self, name: str) -> bool:
        asked = TaskSubmission(task=Task(id=name, kind="visit", place=Point2D(1.0, 1.0)))
        try:
            self.asker.ask(task_messages.TASK_SUBMIT, asked, timeout_s=NOT_NOW_S)
        except (CallError, NobodyThere):
            return False
        self.acknowledged.append(name)
        return True

    def is_same(self) -> bool:
        return self.copy.select(ALL) == self.journal.select(ALL) and all(
            self.copy.history(record.task.id) == self.journal.history(record.task.id)
            and self.copy.asked(record.task.id) == self.journal.asked(record.task.id)
            for record in self.journal.select(ALL)
        )

    @property
    def following(self) -> Following:
        assert self.candidate is not None
        return self.candidate.following

    @property
    def missing(self) -> list[str]:
        return [name for name in self.acknowledged if self.copy.find(name) is None]


@pytest.fixture
def pair() -> Pair:
    return Pair()


def test_one_that_joins_late_copies_all_that_there_is_and_then_follows(pair: Pair) -> None:
    for number in range(200):  # more than one page
        assert pair.submit(f"early{number}")
    pair.run(TICK_S)
    r1, r2 = (KnownRobot(5, False, RobotSummary(name=name, up=False, age_s=3.0)) for name in ("r1", "r2"))
    pair.journal.record_robots({"r1": r1})
    pair.join()
    assert pair.following is Following.IN_STEP
    assert pair.is_same()
    assert pair.copy.robots == {"r1": r1}
    pair.waiting = ["late"]
    pair.journal.record_robots({"r2": r2})
    pair.run(0.3)
    assert pair.copy.robots == {"r2": r2}
    assert pair.acknowledged[-1] == "late"
    assert pair.is_same()


def test_a_task_is_acknowledged_once_the_other_disk_has_it_and_not_before(pair: Pair) -> None:
    pair.join()
    assert not pair.submit("t1")
    assert pair.copy.find("t1") is None
    pair.run(2 * TICK_S)
    assert pair.copy.find("t1") is not None
    assert pair.submit("t1")


def test_a_submission_that_the_other_disk_may_lack_is_answered_with_the_reason(pair: Pair, monkeypatch) -> None:
    monkeypatch.setattr(JournalFeed, "when_kept", lambda _feed, _on_kept, on_lost: on_lost("another may lead"))
    asked = TaskSubmission(task=Task(id="t1", kind="visit", place=Point2D(1.0, 1.0)))
    with pytest.raises(CallError, match=r"^task t1 may get lost: another may lead; ask again$") as lost:
        pair.asker.ask(task_messages.TASK_SUBMIT, asked)
    assert (lost.value.code, lost.value.detail) == (ErrorCode.FAILED, "another may lead")


def test_a_coordinator_that_ends_loses_pending_answers_and_follows_its_journal_no_more(pair: Pair) -> None:
    pair.join()
    assert not pair.submit("t1")
    feed, kept, lost = pair.coordinator.part(ElectedLeadership).feed, [], []
    feed.when_kept(lambda: kept.append(1), lost.append)
    feed.close()
    assert (kept, lost) == ([], ["this coordinator ends, and another may lead"])
    before = feed.status()
    assert (before.in_step, before.why) == (False, "the coordinator ends")
    pair.submit("t2")
    assert feed.status() == before


@pytest.mark.parametrize(
    ("election", "journal", "is_suspended", "leads"),
    [(2, "x", False, False), (1, "x", False, False), (2, "x", True, True), (0, "x", False, True), (1, "", False, True)],
)
def test_a_coordinator_ends_for_another_that_was_elected_later_or_with_a_copied_journal(
    pair: Pair, election: int, journal: str, is_suspended: bool, leads: bool
) -> None:
    pair.run(0.5)
    lead = Lead(election=election, journal=journal or pair.journal.name, is_suspended=is_suspended)
    pair.endpoint().publisher(COORDINATOR_STATE).put(TeamState(robots=[], lead=lead))
    pair.run(0.1)
    mandate = pair.coordinator.part(ElectedLeadership).mandate
    assert mandate.leads(pair.clock.now_ns()) is leads
    assert mandate.superseded == ("" if leads else f"another coordinator leads, by election {election}")


def test_one_that_is_silent_is_out_of_step_after_a_second_and_joins_again(pair: Pair) -> None:
    pair.join()
    cut = FaultSpec(robot=OTHER, kind=FaultKind.PARTITION, at_s=0.0)
    pair.faults.begin(1, cut)
    pair.waiting = ["t1"]
    pair.run(0.8)
    assert pair.acknowledged == []
    pair.run(0.5)
    assert pair.acknowledged == ["t1"]
    feed = pair.coordinator.part(ElectedLeadership).feed
    assert not feed.status().in_step
    assert feed.status().why == "it is silent"
    pair.faults.end(1)
    pair.run(0.5)
    assert pair.following is Following.BEHIND
    pair.run(6.0)
    assert pair.following is Following.IN_STEP
    assert pair.is_same()


def test_a_full_disk_of_the_one_that_stands_by_stops_it_and_not_the_coordinator(pair: Pair) -> None:
    pair.join()
    pair.other_disk.is_full = True
    pair.waiting = ["t1"]
    pair.run(2.0)
    assert pair.acknowledged == ["t1"]
    feed = pair.coordinator.part(ElectedLeadership).feed
    assert "full" in feed.status().why
    pair.other_disk.is_full = False
    pair.run(8.0)
    assert pair.following is Following.IN_STEP
    assert pair.is_same()


def test_a_full_disk_of_the_coordinator_acknowledges_nothing_and_copies_nothing(pair: Pair) -> None:
    pair.join()
    pair.disk.is_full = True
    assert not pair.submit("t1")
    pair.run(1.0)
    assert pair.copy.find("t1") is None
    assert pair.following is Following.IN_STEP


def test_a_coordinator_that_begins_anew_is_copied_anew(pair: Pair) -> None:
    pair.join(0.0)
    pair.submit("t1")
    pair.run(1.0)
    pair.disk.pull()
    pair.exchange.drop(COORDINATOR)
    pair.begin()
    pair.run(1.0)
    assert pair.following is Following.IN_STEP
    assert pair.is_same()


def test_tasks_of_a_file_that_becomes_a_copy_are_put_aside(tmp_path) -> None:
    before = Pair(path=tmp_path / "journal")
    before.submit("of-the-coordinator")
    record = before.journal.find("of-the-coordinator")
    assert record is not None
    before.copy.accept(record)
    before.copy.begin_copy()
    assert before.copy.find("of-the-coordinator") is None
    aside = Journal(tmp_path / "journal.before-1")
    assert aside.find("of-the-coordinator") is not None


FAULTS = st.lists(
    st.tuples(
        st.sampled_from((FaultKind.LOSE, FaultKind.REORDER, FaultKind.DELAY, FaultKind.PARTITION)),
        st.floats(0.1, 3.0),
        st.integers(0, 6),
    ),
    max_size=6,
)


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10_000), faults=FAULTS, joins_after=st.integers(0, 100))
def test_a_copy_in_step_has_all_that_was_acknowledged(seed, faults, joins_after) -> None:
    pair = Pair(seed)
    for number in range(joins_after):
        pair.submit(f"before{number}")
    pair.join(0.0)
    for place, (kind, time_s, tasks) in enumerate(faults):
        options = {
            FaultKind.LOSE: {"share": 0.5},
            FaultKind.REORDER: {"late_s": (0.0, 0.5)},
            FaultKind.DELAY: {"late_s": (0.0, 0.5)},
        }.get(kind, {})
        pair.faults.begin(place, FaultSpec(robot=OTHER, kind=kind, at_s=0.0, **options))
        pair.waiting += [f"t{place}-{number}" for number in range(tasks)]
        for _ in range(round(time_s / TICK_S)):
            pair.run(TICK_S)
            if pair.coordinator.part(ElectedLeadership).feed.stand_by:
                assert pair.missing == []
        pair.faults.end(place)
        pair.run(0.3)
    pair.run(8.0)
    assert pair.waiting == []
    assert pair.following is Following.IN_STEP
    assert pair.is_same()
