"""Tasks that must be done by the robot of another task, and tasks whose robot is changed, in whole runs."""

import pytest

from robrain import Team
from robrain.protocol.errors import CallError
from robrain.protocol.messages.tasks.task_messages import TaskFilter
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.reasons import Gone, OutOfService, SameRobot
from tests.sim.lockstep.test_robots_out_of_service import explored_hall


def submit_pair(team: Team) -> tuple[str, str, str]:
    """A task on the right, one for its robot near the other robot; and the robot of both."""
    pick = team.submit("visit", id="pick", place=(9.0, 5.0), service_s=3.0)
    team.submit("visit", id="drop", place=(2.0, 1.0), same_robot_as=pick.task.id, after=[pick])
    team.run_for(2.0)
    return "pick", "drop", team.get("pick").robot


@pytest.mark.slow
def test_the_robot_of_a_task_does_its_second_half_though_another_one_is_nearer() -> None:
    with explored_hall() as (_, team):
        pick, drop, robot = submit_pair(team)
        done = team.wait_all([pick, drop])
        assert [(one.state, one.robot) for one in done] == [(TaskState.DONE, robot)] * 2


def test_a_plan_gives_a_task_to_the_robot_that_can_do_its_second_half_too() -> None:
    with explored_hall() as (_, team):
        pose = team.state("r1").pose
        team.submit("visit", id="pick", place=(pose.x_m, pose.y_m), earliest_in_s=2.0)
        for task, needs in (("drop", ["r2"]), ("third", [])):
            team.submit("visit", id=task, place=(5.0, 3.0), same_robot_as="pick", needs=needs)
        done = team.wait_all(["pick", "drop", "third"])
        assert [(one.state, one.robot) for one in done] == [(TaskState.DONE, "r2")] * 3


@pytest.mark.slow
def test_a_task_waits_while_the_other_has_no_robot_and_says_so() -> None:
    with explored_hall() as (_, team):
        for robot in ("r1", "r2"):
            team.hold_robot(robot)
        team.submit("visit", id="pick", place=(9.0, 5.0))
        team.submit("visit", id="drop", place=(2.0, 1.0), same_robot_as="pick")
        team.run_for(3.0)
        assert team.why("drop").reason == SameRobot("pick")
        assert team.why("drop").now == "Queued. pick, whose robot is to do it too, has no robot yet."
        team.release_robot("r2")
        assert {one.robot for one in team.wait_all(["pick", "drop"])} == {"r2"}


@pytest.mark.slow
@pytest.mark.parametrize("restarts", [False, True])
def test_a_task_whose_robot_has_gone_or_is_out_of_service_waits_for_it_and_says_so(restarts: bool) -> None:
    with explored_hall() as (run, team):
        pick, drop, robot = submit_pair(team)
        team.hold_robot(robot, "repair")
        team.wait(pick)
        if restarts:
            run.end_coordinator()
            run.begin_coordinator()
        team.run_for(3.0)
        assert team.get(drop).reason == SameRobot(pick, robot, OutOfService(by="ann", why="repair"))
        text = f"only {robot} may do it, as the robot of pick; {robot} is out of service by ann: repair"
        assert team.get(drop).why == text
        team.hold_robot(robot, retires=True)
        run.switch_off(robot)
        team.run_for(5.0)
        assert robot not in team.robots
        assert team.get(drop).reason == SameRobot(pick, robot, Gone())
        assert team.get(drop).state is TaskState.QUEUED


def test_a_task_ends_if_the_one_whose_robot_it_needs_is_not_done() -> None:
    with explored_hall() as (_, team):
        pick, drop, _ = submit_pair(team)
        team.cancel(pick)
        assert team.wait(drop).why == "pick, which it waits for, was not done: cancelled, cancelled by ann"


@pytest.mark.parametrize(
    ("same_robot_as", "words"),
    [
        ("nothing", "it is to wait for task nothing, and there is none of that name"),
        ("own", "it would wait for itself: own after own"),
        ("lift", "it is for the robot of lift, and that task is for 2 robots"),
    ],
)
def test_a_task_that_can_have_no_robot_is_refused(same_robot_as: str, words: str) -> None:
    with explored_hall() as (_, team):
        team.submit("visit", id="lift", place=(9.0, 5.0), robots=2)
        with pytest.raises(CallError, match=words):
            team.submit("visit", id="own", place=(2.0, 1.0), same_robot_as=same_robot_as)


@pytest.mark.slow
def test_a_running_task_is_paused_given_to_another_robot_and_done_by_it() -> None:
    with explored_hall() as (run, team):
        task = team.submit("visit", place=(9.0, 5.0), service_s=1.0)
        team.run_for(2.0)
        robot = team.get(task).robot
        other = {"r1": "r2", "r2": "r1"}[robot]
        team.change([task], paused=True, why="people on the floor")
        team.run_for(5.0)
        body = run.arena.bodies[int(robot[1:]) - 1]
        place = Point2D(body.x_m, body.y_m)
        run.end_coordinator()
        run.begin_coordinator()
        team.run_for(5.0)
        assert place.distance_m(Point2D(body.x_m, body.y_m)) < 0.02
        found = team.why(task)
        assert found.record.state is TaskState.QUEUED
        assert found.now == "Queued. Paused by ann: people on the floor."
        [changed] = team.change(TaskFilter(kinds=["visit"]), paused=False, robot=other)
        assert changed.task.needs == (other,)
        done = team.wait(task)
        assert (done.state, done.robot) == (TaskState.DONE, other)
        assert team.cancel_all(TaskFilter()) == []
