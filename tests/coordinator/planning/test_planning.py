"""The coordinator plans: what it tells of it, what it does on news, and what it does not."""

from itertools import pairwise

import msgspec
import pytest

from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.planning.plan_search import LockstepPlanner
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.errors import CallError
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.tasks import plan_messages
from robrain.protocol.messages.tasks.plan_messages import ObjectiveRequest, PlanningStatus
from robrain.protocol.messages.tasks.task_messages import TASK_EXPLAIN, TaskExplanation, TaskRecord, TaskRequest
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import needed_for
from tests.coordinator.planning.worlds import CAPACITY_J, Worker, run
from tests.plain_reason import Plain


def visit(name: str, x_m: float = 6.0, y_m: float = 4.0, **fields) -> Task:
    return Task(id=name, kind="visit", place=Point2D(x_m, y_m), **fields)


class Ears:
    def __init__(self, team):
        self.problems = Inbox(10_000, every=True)
        team.endpoint().subscribe(self.problems, plan_messages.TASK_PROBLEM)

    def asked(self):
        return [received.message for received in self.problems.drain()]


@pytest.fixture
def ears(team):
    return Ears(team)


def offered(robot):
    return [offer.task.id for offer in robot.offers]


# -- who gets what --------------------------------------------------------------------------------------------


def test_tasks_are_planned_as_routes_and_not_one_by_one(team):
    """Nearest first would send r1 to the task in the middle, and then both across the room."""
    west, east = team.robot("r1", 5.0), team.robot("r2", 8.0)
    workers = [Worker(one, remaining_j=CAPACITY_J) for one in (west, east)]
    team.closed_room()
    team.run(1.0)
    for number, x_m in enumerate((5.8, 4.0, 3.5, 7.0, 8.5)):
        team.submit(visit(f"t{number}", x_m))
    assert run(team, workers, 60.0, until=lambda: set(team.states().values()) == {TaskState.DONE})
    assert {task: name for name, one in (("r1", west), ("r2", east)) for task in offered(one)} == {
        "t0": "r1", "t1": "r1", "t2": "r1", "t3": "r2", "t4": "r2",
    }  # fmt: skip


def test_the_next_task_of_the_route_is_offered_in_the_step_in_which_the_last_is_done(team):
    robot = team.settle("r1", 4.0)
    for number in range(3):
        team.submit(visit(f"t{number}", 5.0 + number))
    team.run(0.5)
    for count in (2, 3):
        robot.end(TaskState.DONE)
        robot.say_state()
        team.run(0.02)
        assert len(robot.offers) == count


def test_a_robot_whose_task_begins_soon_is_not_sent_exploring_and_sets_out_in_time(team):
    robot = team.robot("r1", 5.0)
    worker = Worker(robot, remaining_j=CAPACITY_J)
    team.hall()
    team.submit(visit("t1", 7.5), earliest_in_s=20.0)
    run(team, [worker], 10.0)
    assert robot.offers == []
    run(team, [worker], 6.0)
    assert offered(robot) == ["t1"]  # 2.5 m at 0.5 m/s, and a little margin


def test_a_robot_that_newly_reports_the_end_of_its_task_has_the_plan_checked(team, ears):
    robot = team.settle("r1", 4.0)
    team.submit(visit("first"))
    team.submit(visit("later"), earliest_in_s=60.0)
    team.run(1.0)
    ears.asked()
    for remaining_s, causes in ((30.0, []), (2.0, ["r1 is about to end first"]), (1.5, []), (1.0, [])):
        robot.task = msgspec.structs.replace(robot.task, remaining_s=remaining_s)
        team.run(1.0)
        assert [one.cause for one in ears.asked()] == causes


# -- energy -----------------------------------------------------------------------------------------------------


def test_a_task_that_would_not_leave_the_reserve_is_left_out_and_everybody_is_told_why(team):
    robot = team.robot("r1", 3.5)
    robot.plugins = ["visit"]
    worker = Worker(robot, remaining_j=0.101 * CAPACITY_J)
    team.closed_room()
    team.run(1.0)
    team.submit(visit("t1", 8.5))
    run(team, [worker], 2.0)
    assert robot.offers == []
    assert team.states() == {"t1": TaskState.QUEUED}
    assert "% reserve" in team.why("t1")
    found = team.ask(TASK_EXPLAIN, TaskRequest(id="t1"), TaskExplanation)
    assert found.robots[0].reason.code == "below_reserve"
    assert (found.reason.because.robot, found.reason.because.because.code) == ("r1", "below_reserve")
    assert found.record.estimate is None
    queued = team.history("t1")
    run(team, [worker], 5.0)
    assert team.history("t1") == queued  # told once


def test_the_task_of_higher_priority_is_done_when_there_is_energy_for_one(team):
    robot = team.robot("r1", 6.0)
    robot.plugins = ["visit"]
    worker = Worker(robot, remaining_j=0.1 * CAPACITY_J + 260.0)
    team.closed_room()
    team.run(1.0)
    team.submit(visit("near", 6.8))
    team.submit(visit("dear", 3.4, priority=1.5))
    run(team, [worker], 20.0)
    assert offered(robot) == ["dear"]


def test_a_robot_that_goes_home_of_its_own_accord_is_not_planned_with(team):
    tired, fresh = team.robot("r1", 6.0), team.robot("r2", 8.5)
    tired.behavior = "recharge"
    team.closed_room()
    team.run(1.0)
    team.submit(visit("t1", 6.0))
    team.run(1.0)
    assert offered(fresh) == ["t1"]
    found = team.ask(TASK_EXPLAIN, TaskRequest(id="t1"), TaskExplanation)
    assert [one.refusal for one in found.robots] == ["goes home to charge", ""]
    fresh.end(TaskState.DONE)
    fresh.behavior, tired.behavior = "go home", "idle"
    team.run(0.5)
    team.submit(visit("t2", 6.5))
    team.run(0.5)
    assert offered(tired) == ["t2"]


@pytest.mark.parametrize("is_able_robot_out", [False, True])
def test_a_task_that_no_robot_can_do_fails_after_a_while_without_a_deadline_or_an_able_robot(team, is_able_robot_out):
    team.begin(None, PlanningPolicy(give_up_s=5.0))
    worker = Worker(team.robot("r1", 3.5), remaining_j=0.101 * CAPACITY_J)
    if is_able_robot_out:
        team.robot("r2", 8.0).halted = True
    team.closed_room()
    team.run(1.0)
    team.submit(visit("t", 8.5))
    team.submit(visit("with-deadline", 8.5), deadline_in_s=60.0)
    run(team, [worker], 4.0)
    assert set(team.states().values()) == {TaskState.QUEUED}
    run(team, [worker], 8.0)
    is_kept = TaskState.QUEUED if is_able_robot_out else TaskState.FAILED
    assert team.states() == {"t": is_kept, "with-deadline": TaskState.QUEUED}
    assert [event.reason for event in team.heard if event.state is TaskState.FAILED] == (
        [] if is_able_robot_out else [Plain("gave_up")]
    )


def test_a_task_after_one_that_the_journal_has_lost_is_planned_for_nobody(team):
    journal = Journal()
    journal.accept(TaskRecord(task=visit("t", after=("lost",)), state=TaskState.QUEUED))
    team.begin(journal)
    robot = team.settle()
    team.submit(visit("other"))
    team.run(1.0)
    assert offered(robot) == ["other"]
    assert team.ask(TASK_EXPLAIN, TaskRequest(id="t"), TaskExplanation).reason.code == "after_unknown"


def test_what_a_robot_explores_is_called_off_for_a_task(team):
    robot = team.explore()
    explored = robot.task.id
    team.submit(visit("t", 7.0))
    team.run(0.5)
    assert robot.task.id == "t"
    assert [event.reason for event in team.heard if event.task.id == explored][-1] == needed_for("r1", "t")


# -- the objective ----------------------------------------------------------------------------------------------


def test_the_objective_is_told_and_changed_while_the_team_works(team, ears):
    robots = [team.robot("r1", 5.0), team.robot("r2", 5.2)]
    team.begin(None, PlanningPolicy(delay_w=0.0))
    workers = [Worker(robot, remaining_j=CAPACITY_J) for robot in robots]
    team.closed_room()
    run(team, workers, 1.0)
    for number in range(4):
        team.submit(visit(f"t{number}", 3.6 + 0.3 * number, service_s=60.0))
    run(team, workers, 1.0)
    assert [len(robot.offers) for robot in robots] == [1, 0]  # least energy: one robot for all
    status = team.ask(plan_messages.COORDINATOR_PLANNING, None, PlanningStatus)
    assert (status.objective, status.method, status.planned) == (Objective.ENERGY, "optimal", 3)
    status = team.ask(
        plan_messages.COORDINATOR_OBJECTIVE, ObjectiveRequest(objective=Objective.MAKESPAN, by="ann"), PlanningStatus
    )
    assert status.objective is Objective.MAKESPAN
    run(team, workers, 1.0)
    assert [len(robot.offers) for robot in robots] == [1, 1]
    assert ears.asked()[-1].objective is Objective.MAKESPAN
    with pytest.raises(CallError, match="ObjectiveRequest"):
        team.asker.ask(plan_messages.COORDINATOR_OBJECTIVE, b'{"objective":"speed"}')


@pytest.mark.parametrize(("visits", "iterations"), [(0, 40), (50, 40), (100, 20), (400, 5), (401, 5), (10_000, 5)])
def test_searches_of_many_visits_are_shorter_but_never_of_fewer_than_five_iterations(visits, iterations):
    assert PlanningPolicy(iterations=40).iterations_for(visits) == iterations


def test_a_coordinator_that_plans_has_its_planner_prepared_and_closed_with_it(team, monkeypatch):
    called = []

    class Planner(LockstepPlanner):
        def prepare(self):
            called.append("prepare")

        def close(self):
            called.append("close")

    monkeypatch.setattr("robrain.coordinator.planning.planning._planner_of", lambda _: Planner())
    for method, expected in (("optimal", ["prepare", "close"]), ("nearest", ["close"])):
        team.begin(None, PlanningPolicy(method=method))
        team.coordinator.planning.prepare()
        team.coordinator.close()
        assert called == expected
        called.clear()


@pytest.mark.parametrize("refresh_s", [2.0, 5.0])
def test_while_nothing_happens_a_plan_is_looked_at_again_after_a_while_and_not_before(team, refresh_s):
    team.begin(None, PlanningPolicy(refresh_s=refresh_s))
    heard = Inbox(1000, every=True)
    team.endpoint().subscribe(heard, plan_messages.TASK_PROBLEM)
    team.settle()
    team.submit(visit("at"))
    team.submit(visit("next", 5.0))
    team.run(16.0)
    problems = [received.message for received in heard.drain()]
    again = [one.asked_ns for one in problems if one.cause == "a while has passed"]
    gaps_s = [(later - sooner) / 1e9 for sooner, later in pairwise(again)]
    assert len(gaps_s) >= 1
    assert all(refresh_s < gap_s <= refresh_s + 0.5 for gap_s in gaps_s)  # it looks twice a second
    assert problems[-1].asked_ns == again[-1]
