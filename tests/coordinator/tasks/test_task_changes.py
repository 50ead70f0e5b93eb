"""Changes of tasks that were submitted: priority, times, robot, pause; and cancellation by filter."""

import pytest

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.planning.policy import NEAREST, PlanningPolicy
from robrain.protocol.errors import CallError
from robrain.protocol.messages.tasks.task_messages import (
    TASK_CHANGE,
    TASK_GET,
    TaskFilter,
    TaskRecord,
    TaskRequest,
    TaskUpdate,
)
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.coordinator.conftest import Team
from tests.coordinator.desk_robots import DeskRobot

NO_PLANS = PlanningPolicy(method=NEAREST)


def visit(task_id="t1", x_m=6.0, **fields):
    return Task(id=task_id, kind="visit", place=Point2D(x_m, 4.0), **fields)


def change(team: Team, *ids: str, **fields) -> list[TaskRecord]:
    return team.ask(TASK_CHANGE, TaskUpdate(ids=list(ids), by="ann", **fields), list[TaskRecord])


def get(team: Team, task_id: str = "t1") -> TaskRecord:
    return team.ask(TASK_GET, TaskRequest(id=task_id))


@pytest.fixture
def pair(team):
    """Two robots with the task desk of real ones, in a closed room."""
    robots = [DeskRobot(team, "r1", 5.5), DeskRobot(team, "r2", 8.0)]
    for robot in robots:
        robot.takes_s = 20.0
    team.closed_room()
    team.run(1.0)
    return robots


def test_a_task_whose_item_a_robot_carries_is_offered_to_no_other_unless_a_person_says_so(team, pair):
    first, second = pair
    team.submit(visit())
    team.run(1.0)
    first.desk.carry("t1")
    team.run(0.5)
    first.halted = True
    team.run(5.0)
    assert (first.running, second.running, get(team).task.needs) == ("", "", ("r1",))
    first.halted = False
    team.run(5.0)
    assert first.running == "t1"
    change(team, "t1", robot="r2")
    team.run(3.0)
    assert (first.running, second.running) == ("", "t1")


def test_a_paused_task_is_taken_from_its_robot_and_begun_once_it_is_resumed(team, pair):
    first, second = pair
    team.submit(visit())
    team.run(0.5)
    assert first.running == "t1"
    epoch = get(team).epoch
    change(team, "t1", paused=True, why="the door is closed")
    team.run(0.3)
    found = get(team)
    assert (found.state, found.robot, found.recalled) == (TaskState.QUEUED, "", False)
    assert (found.reason.code, found.why) == ("paused", "paused by ann: the door is closed")
    assert first.running == ""
    team.run(5.0)
    assert (first.running, second.running) == ("", "")
    assert get(team).why == "paused by ann: the door is closed"
    change(team, "t1", paused=False)
    team.run(0.5)
    assert get(team).epoch > epoch
    assert [first.running, second.running].count("t1") == 1
    first.takes_s = second.takes_s = 0.0
    team.run(1.0)
    assert len(first.done + second.done) <= 1


def test_a_task_goes_to_another_robot_only_when_its_robot_has_given_it_back(team, pair):
    first, second = pair
    team.submit(visit())
    team.run(0.5)
    first.isolated = True  # the order to give it back does not arrive, nor does anything of the robot
    [record] = change(team, "t1", robot="r2")
    assert (record.state, record.robot, record.recalled) == (TaskState.RUNNING, "r1", True)
    for _ in range(30):
        team.run(0.1)
        assert [first.running, second.running].count("t1") <= 1
    assert second.running == "t1"
    assert get(team).task.needs == ("r2",)
    assert team.history("t1") == [
        TaskState.QUEUED,
        TaskState.OFFERED,
        TaskState.RUNNING,
        TaskState.RUNNING,  # as changed
        TaskState.LOST_CONTACT,
        TaskState.QUEUED,
        TaskState.OFFERED,
        TaskState.RUNNING,
    ]


@pytest.mark.parametrize("plans", [True, False])
def test_a_task_is_taken_away_from_a_robot_for_good(team, pair, plans):
    first, second = pair
    if not plans:
        team.begin(None, NO_PLANS)
        team.run(2.5)
    team.submit(visit())
    team.run(0.5)
    assert first.running == "t1"
    change(team, "t1", excluded="r1")
    team.run(0.5)
    assert (first.running, second.running) == ("", "t1")
    change(team, "t1", robot="r1")
    team.run(0.5)
    assert (first.running, second.running) == ("t1", "")
    assert (get(team).task.needs, get(team).task.excluded) == (("r1",), ())


def test_the_same_change_again_changes_nothing(team, pair):
    team.submit(visit())
    team.run(0.5)
    for fields in ({"priority": 3.0}, {"robot": "r2"}, {"excluded": "r1"}, {"paused": True}):
        before = change(team, "t1", **fields)
        assert change(team, "t1", **fields) == before, fields
        team.run(1.0)
        history = team.history("t1")
        change(team, "t1", **fields)
        team.run(1.0)
        assert team.history("t1") == history, fields


def test_a_change_of_priority_alone_leaves_a_running_task_at_its_robot(team, pair):
    first, _ = pair
    team.submit(visit())
    team.run(0.5)
    change(team, "t1", priority=7.0)
    team.run(1.0)
    assert first.running == "t1"
    assert first.withdrawals == []
    assert (get(team).task.priority, get(team).state) == (7.0, TaskState.RUNNING)
    assert team.heard[-1].task.priority == 7.0


def test_more_urgent_tasks_are_done_first(team):
    robot = DeskRobot(team, "r1", 6.0)
    team.closed_room()
    team.submit(visit("held"))
    team.submit(visit("a", earliest_ns=1))
    team.submit(visit("b", 6.5, earliest_ns=1))
    team.begin(team.coordinator.tasks.journal, NO_PLANS)
    change(team, "b", priority=5.0)
    change(team, "a", priority=4.0)
    team.run(30.0)
    assert robot.done == ["b", "a", "held"]


def test_a_deadline_may_be_moved_and_counts_for_the_robot_too(team, pair):
    first, _ = pair
    team.submit(visit(), deadline_in_s=3.0)
    team.submit(visit("t2", 8.0), earliest_in_s=100.0)
    team.run(0.5)
    change(team, "t1", deadline_in_s=30.0)
    change(team, "t2", earliest_in_s=0.0, deadline_in_s=40.0)
    team.run(5.0)
    assert first.running == "t1"
    assert first.offers[-1].task.deadline_ns > first.offers[0].task.deadline_ns
    assert team.states() == {"t1": TaskState.RUNNING, "t2": TaskState.RUNNING}
    with pytest.raises(CallError, match="task t1: expected deadline_ns after earliest_ns"):
        change(team, "t1", earliest_in_s=60.0, deadline_in_s=50.0)
    with pytest.raises(CallError, match="task t2: no robot r9 is known; there are: r1, r2"):
        change(team, "t2", robot="r9")


@pytest.mark.parametrize("is_first", [True, False])
def test_a_held_task_is_given_back_or_the_one_before_it(team, is_first):
    robot = DeskRobot(team, "r1", 6.0)
    robot.takes_s = 8.0
    team.closed_room()
    team.submit(visit("now"))
    team.submit(visit("next", 6.2))
    for _ in range(100):
        team.run(0.1)
        if robot.next:
            break
    held, at = robot.next, robot.running
    change(team, at if is_first else held, paused=True)
    team.run(0.3)
    assert (robot.running, robot.next) == ((held, "") if is_first else (at, ""))
    team.run(12.0)
    assert robot.done == [held if is_first else at]
    assert team.states()[at if is_first else held] is TaskState.QUEUED


def test_tasks_are_selected_by_kind_state_robot_requester_and_id(team, pair):
    first, second = pair
    for name, by in (("gate-1", "bob"), ("gate-2", "bob"), ("hall-1", "night-round"), ("hall-2", "bob")):
        team.submit(visit(name, 5.5 if name == "gate-1" else 8.0), by=by)
    team.run(0.5)
    selections = {
        "gate-": TaskFilter(prefix="gate-"),
        "by": TaskFilter(by="night-round"),
        "state": TaskFilter(states=[TaskState.QUEUED]),
        "robot": TaskFilter(robot="r1"),
        "kind": TaskFilter(kinds=["visit"]),
        "none": TaskFilter(kinds=["inspect"]),
        "ended": TaskFilter(states=[TaskState.DONE]),
    }
    found = {
        name: [one.task.id for one in team.ask(TASK_CHANGE, TaskUpdate(which=which), list[TaskRecord])]
        for name, which in selections.items()
    }
    names = ["gate-1", "gate-2", "hall-1", "hall-2"]
    assert found == {
        "gate-": ["gate-1", "gate-2"],
        "by": ["hall-1"],
        "state": [name for name in names if name not in (first.running, second.running)],
        "robot": [first.running],
        "kind": names,
        "none": [],
        "ended": [],
    }


def test_tasks_are_cancelled_by_filter(team, pair):
    first, second = pair
    for name in ("a-1", "a-2", "b-1"):
        team.submit(visit(name))
    team.run(0.5)
    update = TaskUpdate(which=TaskFilter(prefix="a-"), by="ann", why="enough", cancels=True)
    cancelled = team.ask(TASK_CHANGE, update, list[TaskRecord])
    assert {(one.task.id, one.state, one.why) for one in cancelled} == {
        (name, TaskState.CANCELLED, "cancelled by ann: enough") for name in ("a-1", "a-2")
    }
    assert team.ask(TASK_CHANGE, update, list[TaskRecord]) == []
    team.run(1.0)
    assert {first.running, second.running} == {"b-1", ""}
    assert {one.state for one in change(team, "a-1", "a-2", cancels=True)} == {TaskState.CANCELLED}


def test_an_update_that_is_wrong_for_one_task_changes_none(team, pair):
    team.submit(visit())
    team.submit(visit("t2", 8.0))
    team.run(0.5)
    change(team, "t2", cancels=True)
    for ids, words in (
        (("t1", "t2"), "task t2 has ended already: it is cancelled"),
        (("t1", "t9"), "there is no task t9"),
    ):
        with pytest.raises(CallError, match=words):
            change(team, *ids, priority=9.0)
    assert get(team).task.priority == 1.0


@pytest.mark.parametrize("fields", [{"paused": True}, {"robot": "r2"}, {"excluded": "r1"}])
def test_a_coordinator_that_is_killed_right_after_a_change_completes_it(team, pair, fields):
    first, second = pair
    journal = Journal()
    team.begin(journal)
    team.run(2.5)
    team.submit(visit())
    team.run(0.5)
    assert first.running == "t1"
    change(team, "t1", why="moved", **fields)  # killed before it has sent anything to the robot
    team.begin(journal)
    for _ in range(40):
        team.run(0.1)
        assert [first.running, second.running].count("t1") <= 1
    assert first.running == ""
    assert second.running == ("" if "paused" in fields else "t1")
    if "paused" in fields:
        team.begin(journal)
        team.run(3.0)
        assert (get(team).state, get(team).why) == (TaskState.QUEUED, "paused by ann: moved")


def test_on_a_full_disk_nothing_changes(team, pair, monkeypatch):
    first, _ = pair
    team.submit(visit())
    team.run(0.5)

    def full(*_arguments):
        raise JournalUnwritable(None, "cannot be written: database or disk is full")

    with monkeypatch.context() as disk:
        disk.setattr(team.coordinator.tasks.journal, "change", full)
        with pytest.raises(CallError, match=r"task t1 is not changed: .*disk is full"):
            change(team, "t1", paused=True)
    team.run(1.0)
    assert first.running == "t1"
    assert not get(team).task.paused
