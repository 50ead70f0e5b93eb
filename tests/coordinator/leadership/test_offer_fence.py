"""A coordinator offers nothing while most of its robots may be allocating tasks among themselves, out of its reach."""

from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.leadership import leadership
from robrain.coordinator.leadership.leadership import Leadership
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.tasks.consensus_messages import ROBOT_BALLOT, TeamBallot
from robrain.protocol.messages.tasks.task_messages import TASK_EXPLAIN, TaskExplanation, TaskRequest
from robrain.protocol.messages.team.standing_messages import COORDINATOR_LEAD, KnownRobot, LeadReply, LeadRequest
from robrain.protocol.messages.team.team_messages import RobotSummary
from robrain.protocol.model.ballot import Ballot
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import MinorityReached, TaskReason
from robrain.protocol.wire.session import open_lockstep_session
from tests.coordinator.conftest import Team

ALL = 1_000_000
"""More changes than there are: the robot knows of each."""


class RobotsThatGoOn(Team):
    """Robots in a row that visit places and go on without a coordinator; some are out of the coordinator's reach."""

    def __init__(self, session, robots: int) -> None:
        super().__init__(session)
        self.alone: set[str] = set()
        """Robots that say that they hear no coordinator."""
        for number in range(robots):
            robot = self.robot(f"r{number + 1}", 4.0 + number)
            robot.plugins, robot.continues_for_s, robot.changes_received = ["visit"], 120.0, ALL
        self._numbers = 0
        self._ballots = {robot.name: robot.wire.publisher(ROBOT_BALLOT, robot=robot.name) for robot in self.robots}

    def run(self, duration_s: float) -> None:
        for _ in range(round(duration_s / 0.2)):
            for name in sorted(self.alone):
                self._numbers += 1
                said = Ballot(robot=name, number=self._numbers)
                self._ballots[name].put(TeamBallot(robot=name, ballot=said))
            super().run(0.2)

    def part(self, *robots: str, run_s: float = 1.0) -> None:
        """These robots are not heard, all others are."""
        for robot in self.robots:
            robot.speaks = robot.name not in robots
        self.run(run_s)

    def queue(self, name: str, x_m: float = 5.0, run_s: float = 1.0) -> None:
        """A task is queued, without waiting for any disk."""
        self.coordinator.tasks.add(Task(id=name, kind="visit", place=Point2D(x_m, 4.0)), by="ann")
        self.run(run_s)

    def asked(self) -> list[str]:
        """Tasks that robots were offered."""
        return [offer.task.id for robot in self.robots for offer in robot.offers]

    @property
    def held_back(self) -> TaskReason | None:
        return self.coordinator.part(Leadership).held_back


def team_of(robots: int) -> Iterator[RobotsThatGoOn]:
    with open_lockstep_session() as session:
        team = RobotsThatGoOn(session, robots)
        team.run(3.0)
        yield team
        team.close()


@pytest.fixture
def four() -> Iterator[RobotsThatGoOn]:
    yield from team_of(4)


@pytest.fixture
def two() -> Iterator[RobotsThatGoOn]:
    yield from team_of(2)


@pytest.mark.slow
def test_nothing_is_offered_while_more_than_half_are_out_of_reach(four: RobotsThatGoOn) -> None:
    four.part("r2", "r3", "r4")
    four.queue("t1", run_s=300.0)
    assert four.asked() == []
    reason = MinorityReached(1, 4)
    assert four.ask(TASK_EXPLAIN, TaskRequest(id="t1"), TaskExplanation).reason == four.held_back == reason
    assert four.summary.stand_by.words == (
        "no task is offered: 1 of 4 robots are reached; the others may allocate tasks among themselves (robrain lead)"
    )


def test_tasks_are_offered_a_second_after_enough_are_heard_again(four: RobotsThatGoOn) -> None:
    """They say meanwhile what they have begun."""
    four.part("r2", "r3", "r4")
    four.queue("t1", run_s=3.0)
    four.part("r4", run_s=0.8)
    assert four.asked() == []
    four.run(1.0)
    assert four.asked() == ["t1"]
    assert four.held_back is None


def test_half_of_them_cannot_allocate_so_tasks_are_offered_to_the_others(
    four: RobotsThatGoOn, two: RobotsThatGoOn
) -> None:
    for team, silent in ((four, ("r3", "r4")), (two, ("r2",))):
        team.part(*silent)
        team.queue("t1")
        assert team.asked() == ["t1"]


def test_robots_that_say_that_they_hear_no_coordinator_do_not_count_as_heard(four: RobotsThatGoOn) -> None:
    four.alone = {"r2", "r3", "r4"}
    four.run(1.0)
    four.queue("t1", run_s=5.0)
    assert four.asked() == []
    four.alone = set()
    four.run(3.0)
    assert four.asked() == ["t1"]


@pytest.mark.parametrize("how", ["without consensus", "switched off"])
def test_robots_without_consensus_and_those_that_were_switched_off_do_not_count(how: str) -> None:
    with open_lockstep_session() as session:
        team = RobotsThatGoOn(session, 4)
        for robot in team.robots[1:]:
            if how == "without consensus":
                robot.continues_for_s = robot.changes_received = msgspec.UNSET
        team.run(3.0)
        for robot in team.robots[1:]:
            if how == "switched off":
                robot.leave()
        team.part("r2", "r3", "r4")
        team.queue("t1")
        assert team.asked() == ["t1"]
        team.close()


def test_robots_whose_tokens_go_after_a_silence_are_behind_a_cut(four: RobotsThatGoOn) -> None:
    four.part("r2", "r3", "r4")
    for robot in four.robots[1:]:
        robot.leave()
    four.run(2.0)
    assert four.held_back == MinorityReached(1, 4)


def test_all_tokens_at_once_go_with_the_connection_and_not_with_the_robots(four: RobotsThatGoOn) -> None:
    for robot in four.robots:
        robot.leave()
        robot.speaks = False
    four.run(3.0)
    four.robots[0].come()
    four.robots[0].speaks = True
    four.run(1.0)
    assert four.held_back == MinorityReached(1, 4)


@pytest.mark.slow
def test_robots_count_for_a_while_and_for_longer_while_offers_are_held_back(
    four: RobotsThatGoOn, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leadership, "COUNTED_NS", to_ns(60.0))
    four.part("r4", run_s=65.0)
    four.part("r3", "r4", run_s=3.0)
    assert four.held_back is None, "two of three"
    four.part("r2", "r3", "r4", run_s=3.0)
    assert four.held_back == MinorityReached(1, 3)
    four.run(65.0)
    assert four.held_back == MinorityReached(1, 3)


def test_the_operator_may_say_that_the_others_do_nothing(four: RobotsThatGoOn) -> None:
    four.part("r2", "r3", "r4")
    four.queue("t1", run_s=3.0)
    assert four.ask(COORDINATOR_LEAD, LeadRequest(by="ann"), LeadReply).skipped == ["r2", "r3", "r4"]
    four.run(2.0)
    assert four.asked() == ["t1"]


def test_a_restarted_coordinator_knows_which_robots_may_be_out_of_reach(tmp_path: Path) -> None:
    with open_lockstep_session() as session:
        team = RobotsThatGoOn(session, 4)
        team.begin(Journal(tmp_path / "journal.sqlite"))
        team.run(3.0)
        team.coordinator.tasks.journal.close()
        team.part("r2", "r3", "r4", run_s=0.0)  # their tokens are seen yet
        team.begin(Journal(tmp_path / "journal.sqlite"))
        team.run(3.0)
        team.queue("t1", run_s=3.0)
        assert team.asked() == []
        assert team.held_back == MinorityReached(1, 4)
        assert team.ask(COORDINATOR_LEAD, LeadRequest(by="ann"), LeadReply).skipped == ["r2", "r3", "r4"]
        team.run(2.0)
        assert team.asked() == ["t1"]
        assert team.held_back is None
        team.coordinator.tasks.journal.close()
        team.close()


def test_after_a_night_those_of_the_day_before_do_not_count(tmp_path: Path) -> None:
    with open_lockstep_session() as session:
        team = RobotsThatGoOn(session, 4)
        journal = Journal(tmp_path / "journal.sqlite")
        day_before = (RobotSummary(name=f"r{number}", up=True, age_s=0.0) for number in (2, 3, 4))
        journal.record_robots({summary.name: KnownRobot(0, True, summary) for summary in day_before})
        team.part("r2", "r3", "r4", run_s=0.0)
        for robot in team.robots[1:]:
            robot.leave()
        team._ticks = 40_000
        team.clock.advance_to(to_ns(800.0))
        team.begin(journal)
        team.run(3.0)
        team.queue("t1")
        assert team.asked() == ["t1"]
        journal.close()
        team.close()


def test_what_was_given_to_a_robot_after_the_cut_is_taken_back(four: RobotsThatGoOn) -> None:
    """The others never heard of it, and may begin it themselves."""
    four.queue("t1")
    four.queue("t2", 9.0, run_s=0.6)
    states = {record.task.id: (record.state, record.robot) for record in four.coordinator.tasks.open}
    (known, holder), (state, robot) = states["t1"], states["t2"]
    assert known is state is TaskState.RUNNING
    offered = four.coordinator.tasks.journal.when_offered("t1", holder, four.coordinator.tasks.find("t1").epoch)
    for other in four.robots:
        other.changes_received = ALL if other.name == robot else offered
    four.run(0.2)
    four.part(*({"r1", "r2", "r3", "r4"} - {robot}), run_s=2.0)
    assert four.coordinator.tasks.find("t1").robot == holder
    taken = four.coordinator.tasks.find("t2")
    assert (taken.state, taken.robot, taken.reason) == (TaskState.QUEUED, "", MinorityReached(1, 4))
    assert [one.id for other in four.robots for one in other.withdrawals] == ["t2"]


def test_what_most_have_heard_of_stays_with_its_robot(four: RobotsThatGoOn) -> None:
    four.queue("t1")
    robot = four.coordinator.tasks.find("t1").robot
    unaware = [other for other in four.robots if other.name != robot][:2]
    for other in unaware:
        other.changes_received = 0
    four.run(0.2)
    four.part(*({"r1", "r2", "r3", "r4"} - {robot}), run_s=3.0)
    assert four.held_back is not None
    assert four.coordinator.tasks.find("t1").robot == robot
    assert not any(other.withdrawals for other in four.robots)
