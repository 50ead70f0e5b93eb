"""Which robots are the majority that allocates tasks: one that has just begun is no part of it."""

from collections.abc import Iterator

import pytest

from robrain.protocol.model.tasks.task import TaskState
from tests.agent.consensus.one_robot import OneRobot, alone, visit

NEW = {"is_new": True}


@pytest.fixture
def one() -> Iterator[OneRobot]:
    made = OneRobot()
    yield made
    made.close()


def test_a_robot_is_new_until_a_coordinator_counts_it_as_up(one: OneRobot) -> None:
    one.is_coordinated = False
    assert all(said.is_new for said in one.run(2.0))
    one.is_coordinated = True
    one.run(1.0, team=("r2",))
    assert all(said.is_new for said in one.run(1.0, team=("r2",)))
    one.run(0.2)
    one.is_coordinated = False
    one.run(2.0)
    assert not any(said.is_new for said in one.run(1.0))


def test_a_mate_that_has_just_begun_is_not_counted(one: OneRobot) -> None:
    alone(one)
    assert one.consensus.is_leaderless
    one.says = {"r2": NEW, "r3": {}}
    one.run(0.2)
    assert one.consensus.is_leaderless
    one.says = {"r2": NEW, "r3": NEW}
    one.run(0.2)
    assert not one.consensus.is_leaderless


def test_a_task_is_not_begun_with_a_mate_that_has_just_begun_alone(one: OneRobot) -> None:
    """The coordinator may have given it to the third robot."""
    one.tell(visit("t1"))
    one.run(1.0)
    one.is_coordinated = False
    one.says = {"r2": NEW}
    one.run(10.0)
    assert one.begun == []
    one.says = {"r2": {}}
    one.run(10.0)
    assert one.consensus.is_leaderless


def test_one_that_has_just_begun_joins_those_that_allocate(one: OneRobot) -> None:
    one.is_coordinated = False
    one.says = {"r2": {}, "r3": {}}
    one.run(3.0)
    assert not one.consensus.is_leaderless
    one.says = {"r2": {"allocates": True}, "r3": {}}
    one.run(0.2)
    assert one.consensus.is_leaderless
    assert all(said.allocates for said in one.run(1.0)[1:])


def test_one_that_has_just_begun_does_not_take_the_word_of_another_such(one: OneRobot) -> None:
    one.is_coordinated = False
    one.says = {"r2": {"allocates": True, **NEW}, "r3": {}}
    one.run(3.0)
    assert not one.consensus.is_leaderless


def test_a_team_that_never_had_a_coordinator_allocates(one: OneRobot) -> None:
    one.is_coordinated = False
    one.says = {"r2": NEW, "r3": NEW}
    one.run(3.0)
    assert one.consensus.is_leaderless


def test_robots_tell_which_tasks_a_coordinator_gave_to_one_that_is_silent(one: OneRobot) -> None:
    """A teammate that was cut off meanwhile takes them for queued."""
    one.tell(visit("t1"), TaskState.RUNNING, "r3")
    one.tell(visit("t2"), TaskState.RUNNING, "r2")
    one.tell(visit("t3"))
    one.run(1.0)
    one.is_coordinated = False
    one.says = {"r2": {}}
    (told,) = one.run(3.0)[-1].absent
    assert (told.id, told.robot) == ("t1", "r3")
    assert 117.0 < told.remaining_s < 120.0
    one.is_coordinated = True
    assert [said.absent for said in one.run(2.0)[-1:]] == [[]]
    one.is_coordinated = False
    assert one.run(130.0)[-1].absent == []
