"""The coordinator hands out frontiers, merges maps and tells how the team stands."""

from types import NoneType

import numpy as np
import pytest

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.parts.exploration import Exploration
from robrain.coordinator.planning.plan_executor import OFFERS_MAX
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.errors import CallError
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.protocol.messages.team.standing_messages import COORDINATOR_REMOVE_ROBOT, RobotRemoval
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import FREE, GridGeometry
from robrain.protocol.model.tasks.task import LEASE_S, Task, TaskState
from robrain.protocol.reasons import Gone
from robrain.protocol.refusals import RefusalCode
from tests.coordinator.conftest import TICK_S, Team
from tests.plain_reason import Plain

# -- handing out --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["auction", "nearest"])
def test_a_team_at_rest_is_looked_after_twice_a_second(team, monkeypatch, method):
    team.begin(None, PlanningPolicy(method=method))
    team.robot("r1")
    team.closed_room()
    team.run(2.0)
    looks = []
    monkeypatch.setattr(
        team.coordinator.part(Exploration).explorer, "choose", lambda *_: looks.append(team.clock.now_ns()) or []
    )
    team.run(5.0)
    assert 9 <= len(looks) <= 11


def test_what_is_due_for_many_robots_at_once_is_offered_in_the_next_step_if_it_was_too_much_for_one(team):
    count = OFFERS_MAX + 2
    robots = [team.robot(f"r{number}", 3.4 + 0.3 * number) for number in range(count)]
    for number, robot in enumerate(robots):
        robot.plugins = ["visit", f"tool{number}"]
    team.closed_room()
    team.run(2.0)
    for number in range(count):
        team.submit(
            Task(id=f"t{number}", kind="visit", place=Point2D(3.4 + 0.3 * number, 5.0), needs=(f"tool{number}",))
        )
    offered = []
    for _ in range(10):
        team.run(TICK_S)
        offered.append(sum(len(robot.offers) for robot in robots))
    begin = offered.index(OFFERS_MAX)
    assert offered[begin + 1] == count


def test_an_idle_robot_says_whether_its_task_begins_soon_or_a_plan_is_awaited(team):
    team.begin(None, PlanningPolicy(settle_s=4.0))
    for name, x_m in (("r1", 5.0), ("r2", 7.0)):
        team.robot(name, x_m).plugins = ["visit", "explore", f"only-{name}"]
    team.closed_room()
    team.run(2.0)
    team.submit(Task(id="t1", kind="visit", place=Point2D(6.0, 4.0), needs=("only-r1",)), earliest_in_s=25.0)
    team.run(1.0)
    assert {one.name: one.idle for one in team.summary.robots}["r1"] == Plain("task_soon")
    team.submit(Task(id="t2", kind="visit", place=Point2D(6.0, 4.0), needs=("only-r2",)), earliest_in_s=25.0)
    team.run(1.0)
    assert {one.name: one.idle for one in team.summary.robots} == {
        "r1": Plain("plan_pending"),
        "r2": Plain("plan_pending"),
    }
    team.run(3.0)
    assert {one.name: one.idle for one in team.summary.robots} == {"r1": Plain("task_soon"), "r2": Plain("task_soon")}


def test_each_idle_robot_is_handed_a_frontier_of_its_own(team):
    robots = [team.robot(f"r{number}", 5.0 + 0.6 * number) for number in range(4)]
    team.hall()
    team.run(1.0)
    goals = [(robot.goal.x_m, robot.goal.y_m) for robot in robots]
    assert len(set(goals)) == 4
    assert [len(robot.offers) for robot in robots] == [1, 1, 1, 1]
    assert len({offer.epoch for robot in robots for offer in robot.offers}) == 4
    assert all(robot.offers[0].lease_s == LEASE_S for robot in robots)
    assert all(
        team.history(robot.task.id) == [TaskState.QUEUED, TaskState.OFFERED, TaskState.RUNNING] for robot in robots
    )


def test_a_refused_place_is_offered_to_another_and_not_again_for_a_while(team):
    robot = team.robot("r1")
    robot.accepts = False
    team.corridor()
    team.run(10.0)
    places = [offer.task.place for offer in robot.offers]
    assert len(places) == 2
    assert places[0] != places[1]
    assert team.why(robot.offers[0].task.id) == "r1 refused: no way there"
    assert team.history(robot.offers[0].task.id)[-1] is TaskState.CANCELLED
    other = team.robot("r2")
    team.run(1.0)
    assert other.goal in places
    team.run(8.0)
    assert len(robot.offers) > 2


def test_a_place_where_a_robot_failed_is_shunned_by_it_for_fifteen_seconds(team):
    robot = team.robot("r1", 4.0)
    team.corridor()
    team.run(1.0)
    west = robot.goal
    robot.end(TaskState.FAILED, "the way is blocked")
    team.run(1.0)
    assert team.why(robot.offers[0].task.id) == "the way is blocked"
    assert robot.goal.x_m > 8.0
    robot.end(TaskState.DONE)
    team.run(12.0)
    assert all(offer.task.place != west for offer in robot.offers[1:])
    team.run(2.5)
    robot.end(TaskState.DONE)
    team.run(1.0)
    assert robot.goal == west


def test_robot_that_has_gone_is_listed_with_its_task_until_it_is_removed(team):
    team.robot("r2", 5.0)
    robot = team.robot("r1")
    team.submit(Task(id="t1", kind="visit", place=Point2D(6.0, 4.0)))
    team.run(1.0)

    def remove(name):
        team.ask(COORDINATOR_REMOVE_ROBOT, RobotRemoval(robot=name), NoneType)
        team.run(0.1)

    with pytest.raises(CallError, match="r1 is not removed: it is there"):
        remove("r1")
    robot.speaks = False
    robot.leave()
    team.run(1.0)
    with pytest.raises(CallError, match="r1 is not removed: task t1 may still run on it"):
        remove("r1")
    team.run(60.0)
    gone = {summary.name: summary for summary in team.summary.robots}["r1"]
    assert (gone.out, gone.task, gone.age_s > 60.0) == (Gone(), "t1", True)
    remove("r1")
    assert [summary.name for summary in team.summary.robots] == ["r2"]
    with pytest.raises(CallError, match="no such robot is known; there are: r2"):
        remove("r1")


def test_restarted_coordinator_lists_robots_that_have_gone(team, tmp_path):
    """One goes before the restart, one with it; a task of the journal stays with its robot."""
    journal = Journal(tmp_path / "team.journal")
    team.begin(journal)
    early, late = team.robot("r1"), team.robot("r2", 5.0)
    team.robot("r3", 4.0)
    team.submit(Task(id="t1", kind="visit", place=Point2D(6.0, 4.0)))
    team.run(1.0)
    early.speaks = False
    early.leave()
    team.run(10.0)
    at_r2 = late.offers[-1].task.id
    late.speaks = False
    late.leave()
    journal.close()
    journal = Journal(tmp_path / "team.journal")
    team.begin(journal)
    team.run(0.6)
    assert [robot.name for robot in team.summary.robots] == ["r3"]
    team.run(1.0)
    first, second, _ = team.summary.robots
    assert (first.name, first.out, first.task, round(first.age_s)) == ("r1", Gone(), "t1", 12)
    assert (second.name, second.out, second.task, second.age_s > 1.5) == ("r2", Gone(), at_r2, True)
    team.run(10.0)
    team.ask(COORDINATOR_REMOVE_ROBOT, RobotRemoval(robot="r1"), NoneType)
    team.run(0.2)
    journal.close()
    journal = Journal(tmp_path / "team.journal")
    team.begin(journal)
    team.run(1.2)
    assert [(robot.name, robot.out) for robot in team.summary.robots] == [("r2", Gone()), ("r3", None)]
    journal.close()


def test_a_gap_that_a_robot_does_not_fit_through_is_remembered_where_it_stands(team):
    robot = team.robot("r1", 5.8)
    team.corridor()
    team.run(1.0)
    robot.end(TaskState.FAILED, "the path has been too narrow", gap_m=0.36)
    team.run(0.5)
    (gap,) = team.coordinator.part(Exploration).explorer._narrow.gaps
    assert (gap.place, gap.gap_m) == (Point2D(robot.pose.x_m, robot.pose.y_m), 0.36)


# -- the map --------------------------------------------------------------------------------------------------


def test_a_coordinator_that_comes_late_asks_for_the_whole_map(team):
    robot = team.newcomer("r1", 6.0, 4.0)
    robot.grid.merge_patch(20, 40, np.full((40, 40), FREE, np.int8), 5)
    team.robots.append(robot)
    team.run(1.0)
    assert team.coordinator.team_map.known_area_m2 == pytest.approx(16.0)
    assert len(robot.offers) == 1


def test_a_patch_that_waited_and_does_not_fit_is_counted_as_refused(team):
    team.robot("r1")
    team.hall()
    team.run(0.5)
    team.coordinator.team_map.hold()
    team.robots[0].say_map(GridGeometry(0.05, 0.0, 0.0, 50, 50), PatchCells(0, 0, np.full((5, 5), FREE, np.int8), 400))
    team.run(0.2)
    refusals = team.coordinator._wire.refusals
    assert refusals.counts() == []
    team.coordinator.merge_held_patches()
    (refused,) = refusals.counts()
    assert (refused.topic, refused.code) == (ROBOT_MAP.name, RefusalCode.NOT_PLAUSIBLE)
    assert "the map of r1 cannot be merged" in refused.why


# -- telling --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("empty_s", [0.0, 20.0])
@pytest.mark.parametrize("draw", [Team.closed_room, lambda team: team.draw(0.0, 0.0, 12.0, 8.0)])
def test_all_is_explored_when_for_three_seconds_nobody_could_be_sent_anywhere(team, draw, empty_s):
    team.robot("r1")
    team.run(empty_s)
    draw(team)
    team.run(2.5)
    assert not team.summary.all_explored
    team.run(1.5)
    assert team.summary.all_explored


def test_as_long_as_a_robot_is_at_work_not_all_is_explored(team):
    robot = team.explore()
    team.closed_room()
    team.run(10.0)
    assert not team.summary.all_explored
    robot.end(TaskState.DONE)
    team.run(5.0)
    assert team.summary.all_explored


# -- revising goals -----------------------------------------------------------------------------------------


def revising(team, period_s):
    """A robot in a corridor whose goal is revised; another one accepts nothing."""
    team.coordinator.set_policy(PlanningPolicy(revise_s=period_s))
    robot = team.robot("r1", 4.0)
    team.robot("r2", 4.2).accepts = False
    team.corridor()
    return robot


def test_a_goal_is_revised_when_another_has_become_much_nearer(team):
    robot = revising(team, 1.0)
    team.run(1.0)
    first = robot.offers[0].task
    robot.pose = Pose2D(8.2, robot.pose.y_m, 0.0)
    team.run(2.0)
    assert len(robot.offers) == 2
    assert robot.goal.x_m > 8.0
    assert robot.withdrawals == []
    assert team.history(first.id)[-1] is TaskState.CANCELLED
    assert team.why(first.id) == f"its robot was sent on to {robot.task.id} instead"
    assert team.history(robot.task.id)[-1] is TaskState.RUNNING
    assert team.summary.tasks_open == 1


def test_a_robot_that_refuses_the_new_goal_keeps_the_old_one(team):
    robot = revising(team, 1.0)
    team.run(1.0)
    first, robot.accepts = robot.task.id, False
    robot.pose = Pose2D(8.2, robot.pose.y_m, 0.0)
    team.run(3.0)
    assert len(robot.offers) > 1
    assert team.history(first)[-1] is TaskState.RUNNING
    assert team.history(robot.offers[1].task.id)[-1] is TaskState.CANCELLED
