"""What would follow from a task, asked of the coordinator without submitting it."""

import pytest

from robrain.algorithms.mapping.occupancy_grid import OCCUPIED
from robrain.coordinator.planning.snapshot import HANDLING_S
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.tasks.task_messages import TASK_DRY_RUN, TaskDryRun, TaskSubmission
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import halted


def visit(task_id="t1", x_m=6.0, y_m=4.0, **fields):
    return Task(id=task_id, kind="visit", place=Point2D(x_m, y_m), **fields)


def dry_run(team, task, **times) -> TaskDryRun:
    return team.ask(TASK_DRY_RUN, TaskSubmission(task=task, by="ann", **times), TaskDryRun)


def test_a_dry_run_tells_what_the_task_would_take_each_robot_and_leaves_nothing_behind(team):
    far, near = team.robot("r1", 3.0), team.settle("r2", 7.0)
    found = dry_run(team, visit(service_s=5.0))
    assert (found.refused, found.known, found.waits, found.ahead) == ("", None, "", 0)
    takes = {one.robot: one for one in found.robots}
    assert takes["r2"].distance_m < takes["r1"].distance_m
    assert 0.0 < takes["r2"].arrives_in_s < takes["r1"].arrives_in_s
    assert 0.0 < takes["r2"].energy_j < takes["r1"].energy_j
    assert found.estimate.robot == "r2"
    assert found.estimate.arrives_in_s == pytest.approx(takes["r2"].arrives_in_s + HANDLING_S, abs=0.1)
    assert found.estimate.ends_in_s == pytest.approx(found.estimate.arrives_in_s + 5.0, abs=0.2)
    assert found.delays == []
    team.run(1.0)
    assert team.states() == {}
    assert far.offers == near.offers == []
    assert team.submit(visit()).state is TaskState.QUEUED  # the name is free


def test_a_dry_run_is_refused_in_the_words_in_which_the_submission_would_be(team):
    team.settle()
    for task in (visit(x_m=-3.0), visit(y_m=1.95), visit(needs=("arm",)), visit(deadline_ns=1)):
        refused = dry_run(team, task).refused
        with pytest.raises(CallError) as caught:
            team.submit(task)
        assert refused
        assert caught.value.message == f"task t1 is refused: {refused}"
    with pytest.raises(CallError) as caught:
        dry_run(team, visit(earliest_ns=10**12), deadline_in_s=0.5)
    assert caught.value.code is ErrorCode.BAD_ARGUMENTS


def test_a_dry_run_of_a_known_task_tells_its_state_and_of_another_the_difference(team):
    team.submit(visit())
    same = dry_run(team, visit())
    assert (same.known, same.refused) == (TaskState.QUEUED, "")
    other = dry_run(team, visit(y_m=5.0))
    assert other.refused == "there is another task t1: place.y_m is 4.0, not 5.0"
    assert other.task.place == Point2D(6.0, 4.0)


def test_a_dry_run_tells_what_the_task_would_wait_for(team):
    assert dry_run(team, visit()).reason.code == "nobody_there"
    robot = team.settle()
    later = dry_run(team, visit(), earliest_in_s=30.0)
    assert later.reason.code == "not_before"
    assert later.waits
    assert "there is none of that name" in dry_run(team, visit(after=("door",))).refused
    robot.halted = True
    team.run(1.0)
    (verdict,) = dry_run(team, visit()).robots
    assert verdict.reason == halted()
    assert verdict.energy_j is None


def test_a_dry_run_counts_the_tasks_that_are_at_least_as_urgent_and_not_begun(team):
    team.submit(visit("urgent", priority=5.0))
    team.submit(visit("equal", priority=2.0))
    team.submit(visit("minor", priority=1.0))
    assert dry_run(team, visit(priority=2.0)).ahead == 2


def test_a_dry_run_names_the_tasks_that_would_end_later_and_those_that_would_miss_their_deadline(team):
    robot = team.settle("r1", 4.0)
    team.submit(visit("now", x_m=4.5, service_s=5.0))
    team.run(0.5)
    team.submit(visit("waiting", x_m=8.0), deadline_in_s=40.0)
    team.submit(visit("patient", x_m=8.5))
    team.run(0.5)
    urgent = visit("urgent", x_m=5.0, service_s=60.0, priority=1000.0, deadline_ns=75_000_000_000)
    delays = {one.task: one for one in dry_run(team, urgent).delays}
    assert set(delays) >= {"waiting", "patient"}
    waiting = delays["waiting"]
    assert waiting.misses_deadline or waiting.later_s is None
    assert delays["patient"].later_s > 50.0
    assert not delays["patient"].misses_deadline
    assert [offer.task.id for offer in robot.offers] == ["now"]


@pytest.mark.parametrize(("x_m", "service_s", "blocked"), [(6.05, 60.0, True), (6.05, 2.0, False), (5.0, 60.0, False)])
def test_a_dry_run_names_what_a_robot_in_a_door_cuts_off(team, x_m, service_s, blocked):
    team.robot("r1", 4.0)
    team.robot("r2", 8.0, 3.0)
    team.closed_room()
    team.draw(6.0, 2.0, 6.1, 3.7, OCCUPIED)
    team.draw(6.0, 4.3, 6.1, 6.0, OCCUPIED)
    team.run(1.0)
    team.submit(visit("long", x_m=7.5, y_m=5.5, service_s=100.0))
    team.submit(visit("later", x_m=8.0), earliest_in_s=300.0)
    for number in range(3):
        team.submit(visit(f"here{number}", x_m=4.0 + 0.3 * number, y_m=3.0), earliest_in_s=300.0)
    team.run(1.0)
    found = dry_run(team, visit("door", x_m=x_m, service_s=service_s))
    assert found.estimate is not None
    assert ("later" in found.blocks) == blocked
    assert not {"here0", "here1", "here2"} & set(found.blocks)
