"""The next task is at the robot while the last one is being finished, and neither is lost or done twice."""

import pytest

from robrain.coordinator.journal.journal import Journal
from robrain.protocol.messages.tasks.task_messages import TASK_CANCEL, TASK_EXPLAIN, TaskExplanation, TaskRequest
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.coordinator.desk_robots import DeskRobot

OFFERED, RUNNING, DONE = TaskState.OFFERED, TaskState.RUNNING, TaskState.DONE


def visit(name: str, x_m: float = 6.0, **fields) -> Task:
    return Task(id=name, kind="visit", place=Point2D(x_m, 4.0), **fields)


@pytest.fixture
def robot(team) -> DeskRobot:
    one = DeskRobot(team, "r1", 4.0)
    team.closed_room()
    team.run(1.0)
    return one


def offered(robot) -> list[tuple[str, str]]:
    return [(offer.task.id, offer.after) for offer in robot.offers]


def one_after_the_other(team) -> None:
    """The plan may have an order of its own for what waits."""
    team.submit(visit("a", 4.5))
    team.run(0.2)
    team.submit(visit("b", 5.0))


def until_held(team, robot) -> None:
    one_after_the_other(team)
    for _ in range(100):
        if robot.next:
            return
        team.run(0.1)
    raise AssertionError(f"nothing is held; offered: {offered(robot)}")


def test_the_next_task_is_offered_shortly_before_the_end_of_the_last(team, robot):
    robot.takes_s = 8.0
    one_after_the_other(team)
    team.run(4.5)
    assert offered(robot) == [("a", "")]
    team.run(1.0)
    assert offered(robot) == [("a", ""), ("b", "a")]
    assert team.states() == {"a": RUNNING, "b": OFFERED}
    assert robot.begun == ["a"]


def test_the_next_task_runs_as_soon_as_the_last_is_done_and_is_not_offered_again(team, robot):
    until_held(team, robot)
    team.run(4.0)
    assert robot.begun == ["a", "b"]
    assert team.states() == {"a": DONE, "b": RUNNING}
    assert offered(robot) == [("a", ""), ("b", "a")]
    team.run(5.0)
    assert team.states() == {"a": DONE, "b": DONE}
    assert robot.withdrawals == []


def test_who_asks_is_told_that_a_task_is_next(team, robot):
    until_held(team, robot)
    found = team.ask(TASK_EXPLAIN, TaskRequest(id="b"), TaskExplanation)
    assert found.reason.after == "a"
    assert team.why("b") == "it is next, after a"


def test_nothing_is_offered_ahead_to_a_robot_that_does_not_say_when_it_ends(team, robot):
    robot.tells = False
    one_after_the_other(team)
    team.run(3.5)
    assert offered(robot) == [("a", "")]
    team.run(1.0)
    assert offered(robot) == [("a", ""), ("b", "")]


def test_what_waits_for_the_last_task_or_may_not_begin_yet_is_not_offered_ahead(team, robot):
    team.submit(visit("a", 4.5))
    team.submit(visit("b", 5.0, after=("a",)))
    team.run(3.5)
    assert offered(robot) == [("a", "")]
    team.run(0.7)
    assert offered(robot) == [("a", ""), ("b", "")]
    team.run(5.0)
    team.submit(visit("c", 4.5))
    team.submit(visit("d", 5.0), earliest_in_s=60.0)
    team.run(3.5)
    assert offered(robot)[2:] == [("c", "")]


# -- ends before its time -------------------------------------------------------------------------------------------


def test_a_held_task_that_is_called_off_is_never_begun(team, robot):
    until_held(team, robot)
    team.ask(TASK_CANCEL, TaskRequest(id="b"))
    team.run(0.3)
    assert robot.next == ""
    assert robot.running == "a"
    team.run(5.0)
    assert (robot.begun, team.states()) == (["a"], {"a": DONE, "b": TaskState.CANCELLED})


def test_a_held_task_that_is_refused_when_its_turn_comes_goes_to_another(team, robot):
    robot.refuses = {"b"}
    until_held(team, robot)
    other = DeskRobot(team, "r2", 8.5)
    team.run(6.0)
    assert robot.begun == ["a"]
    assert other.begun == ["b"]
    assert "no way there" in [event.why for event in team.heard if event.state is TaskState.QUEUED]


def test_a_silent_robot_has_neither_after_the_lease_and_another_does_both(team, robot):
    until_held(team, robot)
    other = DeskRobot(team, "r2", 8.5)
    team.run(0.1)
    robot.isolated = True
    team.run(1.9)
    assert other.begun == []
    team.run(0.7)
    assert (robot.running, robot.next) == ("", "")
    assert len(other.begun) == 1
    team.run(12.0)
    assert team.states() == {"a": DONE, "b": DONE}
    assert (robot.done, sorted(other.done)) == ([], ["a", "b"])


# -- the coordinator starts again ------------------------------------------------------------------------------------


def test_a_coordinator_that_begins_anew_knows_both_by_its_journal(team):
    journal = Journal()
    team.begin(journal)
    robot = DeskRobot(team, "r1", 4.0)
    team.closed_room()
    team.run(1.0)
    until_held(team, robot)
    team.begin(journal)
    book = team.coordinator.tasks
    assert (book.of_robot("r1").task.id, book.next_of("r1").task.id) == ("a", "b")
    team.run(4.5)
    assert robot.begun == ["a", "b"]
    team.run(4.0)
    assert team.states() == {"a": DONE, "b": DONE}
    assert robot.begun == ["a", "b"]
    assert robot.withdrawals == []


def test_a_coordinator_that_was_away_while_one_followed_the_other_hears_of_both(team):
    journal = Journal()
    team.begin(journal)
    robot = DeskRobot(team, "r1", 4.0)
    team.closed_room()
    team.run(1.0)
    until_held(team, robot)
    coordinator = team.coordinator
    while robot.running != "b":
        robot.desk.coordinator_seen_ns = team.clock.now_ns()
        team.clock.advance_to(team.clock.now_ns() + 20_000_000)
        robot.say_state()
    assert coordinator.tasks.find("a").state is RUNNING
    team._ticks = team.clock.now_ns() // 20_000_000
    team.begin(journal)
    team.run(0.2)
    assert team.states() == {"a": DONE, "b": RUNNING}
    assert robot.withdrawals == []
