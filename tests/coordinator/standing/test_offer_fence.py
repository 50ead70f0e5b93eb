"""A coordinator offers nothing while one with a copy of its journal may be leading most of its robots."""

from collections.abc import Iterator

import pytest

from robrain.coordinator.standing import offer_fence
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.team.standing_messages import LeadReply, LeadRequest, StandByState
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.reasons.tasks import MinorityHeard
from robrain.protocol.table.standing_topics import COORDINATOR_LEAD, COORDINATOR_STAND_BY
from robrain.protocol.wire.session import open_lockstep_session
from tests.coordinator.standing.parted_team import PartedTeam

STAND_BY = "office-77"


class FencedTeam(PartedTeam):
    """A team, and a process that stands by as long as it is to."""

    def __init__(self, session, robots: int) -> None:
        super().__init__(session, robots)
        self.says_it_stands_by = True
        self._stand_by = self.endpoint().publisher(COORDINATOR_STAND_BY)

    def run(self, duration_s: float) -> None:
        for _ in range(round(duration_s / 0.2)):
            if self.says_it_stands_by:
                term = self.coordinator._term
                self._stand_by.put(StandByState(process=STAND_BY, term=term, on_disk=self.feed_last))
            super().run(0.2)

    @property
    def feed_last(self) -> int:
        feed = self.coordinator.feed
        return 0 if feed is None else feed._last

    def cut(self, *robots: str, stand_by: bool = True) -> None:
        """These, and the one that stands by, are on the other side of a cut link."""
        self.says_it_stands_by = self.says_it_stands_by and not stand_by
        self.part(*robots)


def team_of(robots: int) -> Iterator[FencedTeam]:
    with open_lockstep_session() as session:
        team = FencedTeam(session, robots)
        team.run(2.0)
        yield team
        team.close()


@pytest.fixture
def four() -> Iterator[FencedTeam]:
    yield from team_of(4)


@pytest.fixture
def single() -> Iterator[FencedTeam]:
    yield from team_of(1)


@pytest.mark.parametrize("silent", [("r2", "r3", "r4"), ("r3", "r4")])
def test_half_of_the_robots_or_fewer_get_no_task_until_more_are_heard(four: FencedTeam, silent) -> None:
    four.cut(*silent)
    four.run(3.0)
    four.queue("t1")
    four.run(5.0)
    assert four.asked() == []
    reason = MinorityHeard(4 - len(silent), 4, STAND_BY)
    assert four.why_waiting("t1") == reason
    assert four.summary.stand_by.held_back == reason
    words = (
        f"no task is offered: {reason.heard} of 4 robots are heard, and office-77 may lead the others (robrain lead)"
    )
    four.run(1.0)
    assert four.summary.stand_by.words == words
    four.cut("r4")
    four.run(2.0)
    assert four.asked() == ["t1"]
    assert four.coordinator.fence.reason is None


def test_most_of_the_robots_are_enough(four: FencedTeam) -> None:
    four.cut("r4")
    four.run(3.0)
    four.queue("t1")
    four.run(1.0)
    assert four.asked() == ["t1"]


def test_a_coordinator_that_hears_the_one_that_stands_by_goes_on_with_any_number(four: FencedTeam) -> None:
    four.cut("r2", "r3", "r4", stand_by=False)
    four.run(3.0)
    four.queue("t1")
    four.run(1.0)
    assert four.asked() == ["t1"]


def test_one_that_follows_another_coordinator_does_not_stand_by_for_this_one(four: FencedTeam) -> None:
    four.cut("r2", "r3", "r4")
    for _ in range(5):
        four._stand_by.put(StandByState(process=STAND_BY, term=four.coordinator._term + 5, on_disk=0))
        four.run(1.0)
    four.queue("t1")
    four.run(1.0)
    assert four.asked() == []


def test_without_one_that_stood_by_nothing_is_held_back() -> None:
    with open_lockstep_session() as session:
        team = FencedTeam(session, 4)
        team.says_it_stands_by = False
        team.run(2.0)
        team.cut("r2", "r3", "r4")
        team.run(3.0)
        team.queue("t1")
        team.run(1.0)
        assert team.asked() == ["t1"]
        team.close()


def test_a_fenced_coordinator_that_begins_anew_is_fenced_again(four: FencedTeam) -> None:
    four.cut("r2", "r3", "r4")
    four.run(3.0)
    four.begin(four.coordinator.tasks.journal)
    for robot in four.robots[1:]:
        robot.leave()
        robot.come()
        robot.say_state()  # they were heard once, and the link is cut again
    four.run(3.0)
    four.queue("t1")
    four.run(3.0)
    assert four.asked() == []
    assert four.coordinator.fence.reason == MinorityHeard(1, 4, STAND_BY)


def test_a_team_of_one_robot_is_served(single: FencedTeam) -> None:
    single.cut()
    single.run(3.0)
    single.queue("t1")
    single.run(1.0)
    assert single.asked() == ["t1"]


def test_robots_that_were_switched_off_do_not_count_and_count_again_when_they_are_back(four: FencedTeam) -> None:
    for robot in four.robots[1:]:
        four.run(0.2)  # each was heard just before
        robot.leave()
        robot.speaks = False
    four.says_it_stands_by = False
    four.run(3.0)
    four.queue("t1")
    four.run(1.0)
    assert four.asked() == ["t1"]
    for robot in four.robots[1:]:
        robot.come()
        robot.speaks = True
    four.run(1.0)
    four.cut("r2", "r3", "r4")
    four.run(3.0)
    assert four.coordinator.fence.reason == MinorityHeard(1, 4, STAND_BY)


def test_robots_whose_tokens_go_after_a_silence_are_behind_a_cut(four: FencedTeam) -> None:
    four.cut("r2", "r3", "r4")
    four.run(1.0)
    for robot in four.robots[1:]:
        robot.leave()
    four.run(2.0)
    assert four.coordinator.fence.reason == MinorityHeard(1, 4, STAND_BY)


def test_all_tokens_at_once_go_with_the_connection_and_not_with_the_robots(four: FencedTeam) -> None:
    for robot in four.robots:
        robot.leave()
        robot.speaks = False
    four.says_it_stands_by = False
    four.run(3.0)
    four.robots[0].come()
    four.robots[0].speaks = True
    four.run(1.0)
    assert four.coordinator.fence.reason == MinorityHeard(1, 4, STAND_BY)


def test_the_operators_word_lets_it_go_on_without_the_silent_robots(four: FencedTeam) -> None:
    four.cut("r2", "r3", "r4")
    four.run(3.0)
    four.queue("t1")
    four.run(1.0)
    reply = four.ask(COORDINATOR_LEAD, LeadRequest(by="operator:ann"), LeadReply)
    assert reply.left_out == ["r2", "r3", "r4"]
    four.run(2.0)
    assert four.asked() == ["t1"]
    assert four.ask(COORDINATOR_LEAD, LeadRequest(), LeadReply).left_out == []


@pytest.mark.slow
def test_robots_count_for_a_while_and_for_longer_while_offers_are_held_back(
    four: FencedTeam, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(offer_fence, "HEARD_NS", to_ns(60.0))
    four.cut("r4", stand_by=False)
    four.run(65.0)
    four.cut("r3", "r4")
    four.run(3.0)
    assert four.coordinator.fence.reason is None, "two of three"
    four.cut("r2", "r3", "r4")
    four.run(3.0)
    assert four.coordinator.fence.reason == MinorityHeard(1, 3, STAND_BY)
    four.run(65.0)
    assert four.coordinator.fence.reason == MinorityHeard(1, 3, STAND_BY)


def test_a_running_task_goes_on_and_its_end_is_taken_in(four: FencedTeam) -> None:
    four.queue("t1")
    four.run(1.0)
    (worker,) = (robot for robot in four.robots if robot.task is not None)
    four.cut(*(robot.name for robot in four.robots if robot is not worker))
    four.run(3.0)
    assert four.coordinator.fence.reason is not None
    assert worker.withdrawals == []
    worker.end(TaskState.DONE)
    four.run(1.0)
    assert four.states() == {"t1": TaskState.DONE}
