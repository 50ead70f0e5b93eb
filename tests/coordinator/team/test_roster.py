import pytest

from robrain.coordinator.team.roster import FORGET_UNSEEN_NS, ROBOTS_MAX, ROBOTS_UNSEEN_MAX, Roster, StaleTopics
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.robot_messages import BatteryState, RobotState, TaskStatus
from robrain.protocol.model.tasks.task import LOST_AFTER_S, TaskState
from robrain.protocol.reasons import NoState, TopicStale
from robrain.protocol.wire.presence import Change
from tests.plain_reason import Plain

BATTERY = BatteryState(voltage_v=12.0, current_a=1.0, temperature_c=20.0, soc=0.5, remaining_j=100.0)


def comes(roster, name):
    roster.record_presence(Change({"team": "default", "robot": name}, True))


def goes(roster, name):
    roster.record_presence(Change({"team": "default", "robot": name}, False))


def says(roster, name, at_s, **fields):
    roster.record_state(RobotState(robot=name, **fields), to_ns(at_s))


def names_up(roster, at_s):
    return [robot.name for robot in roster.up(to_ns(at_s))]


@pytest.mark.parametrize("order", [(comes, says), (says, comes)])
def test_token_and_state_may_come_in_either_order(order):
    roster = Roster()
    for step in order:
        step(roster, "r1", 0.0) if step is says else step(roster, "r1")
    assert names_up(roster, 0.1) == ["r1"]


def test_a_token_alone_is_no_robot_to_count_on():
    roster = Roster()
    comes(roster, "r1")
    assert names_up(roster, 0.0) == []
    (summary,) = roster.summaries(0)
    assert (summary.up, summary.out, summary.why, summary.age_s) == (False, NoState(), "no state received yet", 1e6)


@pytest.mark.slow
def test_a_full_roster_accepts_no_new_robot():
    roster = Roster()
    for number in range(ROBOTS_MAX - 1):
        comes(roster, f"r{number}")
    assert roster.rejection("last", 0) == ""
    comes(roster, "last")
    assert roster.rejection("last", 0) == ""
    assert str(ROBOTS_MAX) in roster.rejection("another", 0)


def test_names_without_a_token_are_limited_and_forgotten_when_silent():
    roster = Roster()
    for number in range(ROBOTS_UNSEEN_MAX):
        says(roster, f"r{number}", 0.0)
    assert roster.rejection("another", to_ns(1.0))
    late_ns = FORGET_UNSEEN_NS + 1
    assert roster.rejection("another", late_ns) == ""
    assert not roster.robots


def test_a_robot_that_falls_silent_is_not_counted_on_though_its_token_is_there():
    roster = Roster()
    comes(roster, "r1")
    says(roster, "r1", 1.0)
    assert names_up(roster, 1.0 + LOST_AFTER_S) == ["r1"]
    assert names_up(roster, 1.1 + LOST_AFTER_S) == []
    assert roster.robots["r1"].down_reason(to_ns(3.5)) == Plain("lost_contact", silent_s=2.5)
    says(roster, "r1", 4.0)
    assert names_up(roster, 4.0) == ["r1"]


def test_a_summary_says_what_the_robot_last_said():
    roster = Roster()
    comes(roster, "r1")
    task = TaskStatus(id="explore-1", epoch=4, state=TaskState.RUNNING)
    says(roster, "r1", 2.0, battery=BATTERY, behavior="explore", task=task, halted=True)
    (summary,) = roster.summaries(to_ns(2.25))
    assert (summary.up, summary.out, summary.age_s, summary.halted) == (True, None, 0.25, True)
    assert (summary.soc, summary.behavior, summary.task) == (0.5, "explore", "explore-1")


@pytest.mark.parametrize("state", [state for state in TaskState if state.ended])
def test_a_task_that_has_ended_is_not_in_the_summary(state):
    roster = Roster()
    says(roster, "r1", 0.0, task=TaskStatus(id="explore-1", epoch=4, state=state))
    assert roster.summaries(0)[0].task == ""


@pytest.fixture
def two():
    one = Roster()
    for name in ("r1", "r2"):
        comes(one, name)
        says(one, name, 1.0)
    return one


def test_robot_whose_state_is_older_than_three_periods_is_named_until_it_speaks_again(two):
    watch = StaleTopics(two)
    assert not watch.check(to_ns(1.3))
    assert watch.found == []
    says(two, "r2", 1.35)
    assert watch.check(to_ns(1.41))
    assert watch.found == [TopicStale("robot_state", "r1", 0.41, 0.3)]
    assert str(watch.found[0]) == "robot_state of r1 is 0.4 s old, more than 0.3 s"
    assert not watch.check(to_ns(1.52))
    assert watch.found[0].age_s == 0.52
    says(two, "r1", 1.6)
    assert watch.check(to_ns(1.63))
    assert watch.found == []


def test_robot_that_is_not_counted_on_any_more_is_told_at_once_and_once(two):
    watch = StaleTopics(two)
    assert watch.check(to_ns(1.5))
    assert not watch.check(to_ns(1.79))
    assert watch.check(to_ns(1.91))
    assert not watch.check(to_ns(2.1))


def test_robot_that_has_left_or_has_not_spoken_yet_is_not_stale(two):
    comes(two, "r3")
    goes(two, "r2")
    watch = StaleTopics(two)
    watch.check(to_ns(5.0))
    assert [found.sender for found in watch.found] == ["r1"]


def test_a_robot_that_only_finishes_its_task_alone_does_not_allocate_with_others():
    roster = Roster()
    comes(roster, "v1")
    roster.record_state(RobotState(robot="v1", continues_for_s=30.0), to_ns(1.0))
    assert not roster.some_go_on
    assert not roster.robots["v1"].continues
    assert roster.continues_for_s() == 30.0
    roster.record_state(RobotState(robot="v1", continues_for_s=30.0, changes_received=1), to_ns(2.0))
    assert roster.robots["v1"].continues
