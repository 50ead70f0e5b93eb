"""Tasks for several robots at once: they gather, begin together, and one that fails frees all."""

import math

import pytest

from robrain.coordinator.journal.journal import Journal
from robrain.protocol.messages.tasks.task_messages import TASK_CANCEL, TaskRequest
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import MinorityReached, plain
from tests.coordinator.planning.worlds import CAPACITY_J, Worker, run
from tests.plain_reason import Plain

PLACE = Point2D(6.0, 4.0)


def together(name: str = "lift", robots: int = 2, **fields) -> Task:
    return Task(id=name, kind="visit", place=PLACE, robots=robots, service_s=5.0, **fields)


@pytest.fixture
def crew(team):
    workers = [Worker(team.robot(f"r{number}", 3.6 + 2.2 * number), remaining_j=CAPACITY_J) for number in range(3)]
    team.closed_room()
    run(team, workers, 1.0)
    return workers


def parts(worker, prefix):
    return [offer.task for offer in worker.robot.offers if offer.task.id.startswith(prefix)]


def at_it(crew):
    return [worker for worker in crew if parts(worker, "gather")]


def test_robots_gather_around_the_place_and_begin_when_all_are_there(team, crew):
    team.submit(together())
    begun = []

    def check():
        doing = [worker for worker in crew if parts(worker, "share")]
        if doing and not begun:
            begun.append([worker.robot.pose.distance_m(PLACE) for worker in at_it(crew)])

    assert run(team, crew, 60.0, until=lambda: team.states() == {"lift": TaskState.DONE}, check=check)
    assert team.history("lift") == [TaskState.QUEUED, TaskState.OFFERED, TaskState.RUNNING, TaskState.DONE]
    assert len(at_it(crew)) == 2
    assert max(begun[0]) < 0.6  # all of them were there when the first began
    spots = [parts(worker, "gather")[0].place for worker in at_it(crew)]
    assert math.dist((spots[0].x_m, spots[0].y_m), (spots[1].x_m, spots[1].y_m)) >= 0.6
    assert [len(worker.robot.offers) for worker in at_it(crew)] == [2, 2]
    record = team.coordinator.tasks.find("lift")
    assert record.result["robots"] == sorted(worker.robot.name for worker in at_it(crew))


def test_they_do_not_begin_while_another_coordinator_may_lead(team, crew):
    held_back = MinorityReached(1, 3)
    team.submit(together())
    run(team, crew, 60.0, until=lambda: len(at_it(crew)) == 2)
    team.coordinator.lifecycle.eligibility.offer_refusal = lambda: held_back
    run(team, crew, 60.0)
    assert not any(parts(worker, "share") for worker in crew)
    assert team.states() == {"lift": TaskState.RUNNING}
    team.coordinator.lifecycle.eligibility.offer_refusal = lambda: None
    assert run(team, crew, 60.0, until=lambda: team.states() == {"lift": TaskState.DONE})


def test_those_that_wait_for_the_others_are_given_nothing_else(team, crew):
    team.submit(together())
    run(team, crew, 0.5)
    first, second = at_it(crew)
    team.submit(Task(id="other", kind="visit", place=Point2D(6.1, 4.1)))
    run(team, crew, 2.0)
    assert {offer.task.id.split("-")[0] for one in (first, second) for offer in one.robot.offers} == {"gather"}
    assert run(team, crew, 60.0, until=lambda: set(team.states().values()) == {TaskState.DONE})


@pytest.mark.parametrize("state", [TaskState.FAILED, TaskState.CANCELLED])
def test_one_that_does_not_do_its_part_frees_all_for_a_new_plan(team, crew, state):
    team.submit(together())
    run(team, crew, 1.0)
    _, one = sorted(at_it(crew), key=lambda worker: not worker.robot.task.state.ended)
    one.robot.end(state, "the way is blocked")
    run(team, crew, 0.3)
    assert TaskState.QUEUED in team.history("lift")[1:]
    assert run(team, crew, 90.0, until=lambda: team.states() == {"lift": TaskState.DONE})
    assert team.history("lift").count(TaskState.DONE) == 1


def test_one_that_refuses_frees_all(team, crew):
    crew[1].robot.accepts = False
    team.submit(together())
    assert run(team, crew, 60.0, until=lambda: team.states() == {"lift": TaskState.DONE})
    assert {worker.robot.name for worker in crew if parts(worker, "share")} == {"r0", "r2"}


def test_one_that_is_lost_frees_the_others(team, crew):
    team.submit(together(robots=2))
    run(team, crew, 1.0)
    lost = at_it(crew)[0]
    lost.robot.speaks = False
    left = [worker for worker in crew if worker is not lost]
    assert run(team, left, 60.0, until=lambda: team.states() == {"lift": TaskState.DONE})
    assert {worker.robot.name for worker in left if parts(worker, "share")} == {one.robot.name for one in left}


def test_a_cancelled_task_calls_its_robots_off(team, crew):
    team.submit(together())
    run(team, crew, 1.0)
    team.ask(TASK_CANCEL, TaskRequest(id="lift"))
    run(team, crew, 1.0)
    assert all(worker.robot.task is None or worker.robot.task.state.ended for worker in crew)
    assert not [record for record in team.coordinator.tasks.open if record.own and record.task.id.startswith("gather")]


def test_a_coordinator_that_begins_anew_goes_on_with_it(team, crew):
    journal = Journal()
    team.begin(journal)
    run(team, crew, 1.0)
    team.submit(together())
    killed = []

    def kill():
        told = [len(parts(worker, kind)) for worker in crew for kind in ("gather", "share")]
        if sum(told) > len(killed) * 2 and len(killed) < 2:
            killed.append(told)
            team.begin(journal)

    assert run(team, crew, 120.0, until=lambda: team.states() == {"lift": TaskState.DONE}, check=kill)
    assert len(killed) == 2
    assert team.history("lift").count(TaskState.DONE) == 1
    assert sum(len(parts(worker, "share")) for worker in crew) == 2
    assert sum(len(parts(worker, "gather")) for worker in crew) == 2
    journal.close()


@pytest.mark.parametrize("told", [0, 1])
def test_a_coordinator_that_was_killed_before_all_had_been_told_has_it_planned_anew(team, told):
    journal = Journal()
    team.begin(journal)
    book = team.coordinator.tasks
    book.add(together())
    book.begin_together("lift", plain("gather", "words"))
    for number in range(told):
        book.add(Task(id=f"gather-{number}", kind="visit", place=PLACE), by="lift", own=True)
    assert team.coordinator.tasks.find("lift").state is TaskState.RUNNING
    team.begin(journal)
    team.run(0.1)
    assert team.states()["lift"] is TaskState.QUEUED
    assert Plain("parts_untold") in [event.reason for event in team.heard if event.task.id == "lift"]
    crew = [Worker(team.robot(f"r{number}", 3.6 + 2.2 * number), remaining_j=CAPACITY_J) for number in range(2)]
    team.closed_room()
    assert run(team, crew, 60.0, until=lambda: team.states()["lift"] is TaskState.DONE)
    journal.close()
