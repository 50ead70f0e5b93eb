"""Robots out of service get no tasks, in whole runs with restarts of the coordinator."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from robrain import Scenario, Team
from robrain.protocol.errors import CallError
from robrain.protocol.messages.team.service_messages import RobotLabel
from robrain.protocol.messages.team.team_messages import RobotSummary
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.lockstep.lockstep import LockstepRun, LockstepTransport
from robrain.sim.maps.drawing import FloorDrawing
from robrain.sim.world.world import Fidelity

HALL = Scenario(
    name="hall", floor=FloorDrawing(size_m=(10.0, 6.0)), robots=2, near=Point2D(1.5, 1.5), fidelity=Fidelity.POINTS
)


@contextmanager
def explored_hall() -> Iterator[tuple[LockstepRun, Team]]:
    run = LockstepRun(HALL.world())
    with Team(LockstepTransport(run), by="ann") as team:
        team.run_for(40.0, until=lambda: run.nothing_left)
        yield run, team


def summary(team: Team, robot: str) -> RobotSummary:
    return next(one for one in team.state().robots if one.name == robot)


@pytest.mark.slow
@pytest.mark.parametrize("gives_back", [False, True])
def test_a_robot_out_of_service_finishes_its_task_or_gives_it_back(gives_back: bool) -> None:
    with explored_hall() as (_, team):
        task = team.submit("visit", place=(9.0, 5.0), service_s=10.0)
        team.run_for(2.0)
        robot = team.get(task).robot
        other = {"r1": "r2", "r2": "r1"}[robot]
        team.hold_robot(robot, "battery swap", gives_back=gives_back)
        later = [team.submit("visit", place=place) for place in ((9.0, 1.0), (5.0, 1.0), (2.0, 5.0))]
        done = team.wait_all([task, *later])
        assert {one.state for one in done} == {TaskState.DONE}
        assert [one.robot for one in done] == [other if gives_back else robot, other, other, other]
        team.run_for(1.0)
        assert summary(team, robot).why == "out of service by ann: battery swap"
        verdicts = {one.robot: one.refusal for one in team.dry_run("visit", place=(5.0, 5.0)).robots}
        assert verdicts[robot] == "out of service by ann: battery swap"


@pytest.mark.slow
def test_a_paused_robot_stands_keeps_its_task_and_continues_also_after_a_restart_of_the_coordinator() -> None:
    with explored_hall() as (run, team):
        task = team.submit("visit", place=(9.0, 5.0))
        team.run_for(3.0)
        robot = team.get(task).robot
        body = run.arena.bodies[int(robot[1:]) - 1]
        team.hold_robot(robot, "people on the floor", pauses=True)
        team.run_for(2.0)
        place, epoch = Point2D(body.x_m, body.y_m), team.get(task).epoch
        assert place.distance_m(Point2D(9.0, 5.0)) > 1.0
        run.end_coordinator()
        run.begin_coordinator()
        team.run_for(20.0)
        assert place.distance_m(Point2D(body.x_m, body.y_m)) < 0.02
        assert (team.get(task).state, team.get(task).epoch) == (TaskState.RUNNING, epoch)
        assert summary(team, robot).why == "paused by ann: people on the floor"
        team.release_robot(robot)
        done = team.wait(task)
        assert (done.robot, done.epoch) == (robot, epoch)


@pytest.mark.slow
def test_a_robot_drives_to_its_place_out_of_service_and_works_again_once_released() -> None:
    with explored_hall() as (run, team):
        for robot in ("r1", "r2"):
            team.hold_robot(robot, place=(8.0, 1.0) if robot == "r1" else (8.0, 5.0))
        task = team.submit("visit", place=(1.0, 1.0))
        team.run_for(40.0)
        places = [Point2D(body.x_m, body.y_m) for body in run.arena.bodies]
        assert places[0].distance_m(Point2D(8.0, 1.0)) < 0.5
        assert places[1].distance_m(Point2D(8.0, 5.0)) < 0.5
        assert team.get(task).state is TaskState.QUEUED
        assert {one.robot for one in team.why(task).robots if "out of service" in one.refusal} == {"r1", "r2"}
        run.end_coordinator()
        run.begin_coordinator()
        team.run_for(5.0)
        assert team.get(task).state is TaskState.QUEUED
        team.release_robot("r2")
        assert team.wait(task).robot == "r2"
        with pytest.raises(CallError, match="r2 is in service; robots out of service: r1"):
            team.release_robot("r2")


def test_a_retired_robot_is_forgotten_once_it_has_left() -> None:
    with explored_hall() as (run, team):
        team.hold_robot("r1", retires=True)
        team.run_for(1.0)
        assert summary(team, "r1").up
        run.switch_off("r1")
        team.run_for(3.0)
        assert team.robots == ["r2"]


def test_a_robot_that_is_not_known_is_not_held() -> None:
    with explored_hall() as (_, team), pytest.raises(CallError, match="no such robot is known; there are: r1, r2"):
        team.hold_robot("r9")


def test_a_renamed_robot_keeps_its_label_over_a_restart_of_the_coordinator_and_is_held_by_it() -> None:
    with explored_hall() as (run, team):
        team.rename_robot("r1", "Picker")
        for taken in ("Picker", "r1"):
            with pytest.raises(CallError, match=f"r2 is not renamed: {taken} names r1"):
                team.rename_robot("r2", taken)
        run.end_coordinator()
        run.begin_coordinator()
        team.run_for(2.0)
        assert summary(team, "r1").title == "Picker (r1)"
        assert summary(team, "r1").label == RobotLabel("Picker", "ann")
        team.hold_robot("Picker")
        team.run_for(1.0)
        assert summary(team, "r1").why == "out of service by ann"
        team.rename_robot("Picker", "")
        team.run_for(1.0)
        assert summary(team, "r1").title == "r1"
