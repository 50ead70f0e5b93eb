"""A task that cannot be planned is set aside with its reason, and the others are planned."""

import msgspec
import pytest

from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.planning.plan_search import PlanSearch
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.messages.robots.robot_messages import BatteryState, RobotState
from robrain.protocol.messages.tasks import task_messages
from robrain.protocol.messages.tasks.task_messages import TaskExplanation, TaskRecord, TaskRequest
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.ranges import METRES_MAX, PRIORITY_MAX, STAMP_MAX
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.coordinator.planning.snapshots import open_floor_snapshot
from tests.energy_models import energy_model
from tests.plain_reason import Plain

PLACE = Point2D(2.0, 3.0)
HUGE = {"priority": 1e308, "service_s": 1e308}


def task_with(name, place=PLACE, after=(), **out_of_range):
    """A task, with numbers that no border lets pass."""
    task = Task(id=name, kind="visit", place=place, after=after)
    for field, value in out_of_range.items():
        msgspec.structs.force_setattr(task, field, value)
    return task


def queued(name, **fields):
    return TaskRecord(task=task_with(name, **fields), state=TaskState.QUEUED)


def with_tasks(*records, tasks=3):
    snapshot = open_floor_snapshot(1, tasks)
    return msgspec.structs.replace(snapshot, records=(*snapshot.records, *records))


def plan(snapshot, method="optimal"):
    draft = PlanSearch().draft(snapshot, PlanningPolicy(method=method))
    draft.solver.run(rounds=1)
    return draft.planned()


def planned_tasks(made):
    return {task for _, tasks in made.problem.routes for task in tasks}


@pytest.mark.parametrize("field", HUGE)
def test_a_task_that_cannot_be_planned_is_set_aside_with_its_reason(field):
    made = plan(with_tasks(queued("bad", **{field: HUGE[field]})))
    assert planned_tasks(made) == {"t0", "t1", "t2"}
    assert made.waiting["bad"].code == "cannot_be_planned"


def test_what_waits_for_such_a_task_says_so_and_is_not_planned():
    made = plan(with_tasks(queued("bad", priority=1e308), queued("next", after=("bad",))))
    assert planned_tasks(made) == {"t0", "t1", "t2"}
    assert made.waiting["next"] == Plain("after_unplanned", task="bad")


@pytest.mark.parametrize("method", ["greedy", "auction", "optimal"])
@pytest.mark.parametrize(
    "fields",
    [
        {"priority": PRIORITY_MAX},
        {"priority": 1e-300},
        {"service_s": 1e6},
        {"earliest_ns": STAMP_MAX},
        {"deadline_ns": STAMP_MAX},
        {"place": Point2D(METRES_MAX, -METRES_MAX)},
        {"robots": 1000},
    ],
    ids=str,
)
def test_whatever_a_task_may_say_does_not_keep_others_from_being_planned(method, fields, caplog):
    made = plan(with_tasks(queued("odd", **fields)), method)
    assert {"t0", "t1", "t2"} <= planned_tasks(made)
    assert not caplog.records


MODEL = energy_model(
    8.0,
    0.5,
    7.5,
    1.25,
    8.0,
    residual_w2_s=4.0,
    drift_w2_per_s=0.0003,
    relative_sd=0.03,
    path_ratio=1.02,
    turn_rate_rad_s=1.2,
    packet_j=0.0008,
    usable_j=240000.0,
    power_w=12.5,
    usual_power_w=11.0,
)


@pytest.mark.parametrize(
    "fields",
    [
        {"coefficients": (1e6,) * 5},
        {"coefficients": (-1e6,) * 5},
        {"covariance": (1e15,) * 15},
        {"covariance": (-1e15,) * 15},
        {"residual_w2_s": 1e12, "drift_w2_per_s": 1e12},
        {"pace_m_s": 1e-3, "turn_rate_rad_s": 1e-3},
        {"pace_m_s": 1e6},
        {"path_ratio": 1e3, "relative_sd": 1e3},
        {"path_ratio": 0.0},
        {"usable_j": 1e12},
        {"usable_j": -1e12},
    ],
    ids=str,
)
def test_whatever_a_robot_says_of_its_energy_there_is_a_plan(fields, caplog):
    battery = BatteryState(voltage_v=24.0, current_a=1.0, temperature_c=20.0, soc=0.5, remaining_j=1e12)
    odd = RobotState(
        robot="r1", pose=Pose2D(3.0, 2.0, 0.0), battery=battery, energy=msgspec.structs.replace(MODEL, **fields)
    )
    snapshot = open_floor_snapshot(1, 3)
    members = {**snapshot.members, "r1": snapshot.members["r1"]._replace(state=odd)}
    made = plan(msgspec.structs.replace(snapshot, members=members))
    assert planned_tasks(made) | made.left_out.keys() == {"t0", "t1", "t2"}
    assert not caplog.records


@pytest.mark.parametrize("field", HUGE)
def test_a_coordinator_whose_journal_has_such_a_task_ends_it_and_plans_the_others(team, tmp_path, field):
    path = tmp_path / "team.journal"
    journal = Journal(path)
    for name, fields in (("bad", {field: HUGE[field]}), ("good", {})):
        accepted = journal.accept(queued(name, place=Point2D(6.0, 4.0), **fields), b"{}")
        team.heard.append(accepted.event)
    journal.close()
    robot = team.robot("r1")
    reopened = Journal(path)
    team.begin(reopened)
    team.run(2.0)
    assert team.states() == {"bad": TaskState.FAILED, "good": TaskState.RUNNING}
    assert f"$.task.{field}" in team.why("bad")
    assert robot.task.id == "good"
    why = team.ask(task_messages.TASK_EXPLAIN, TaskRequest(id="bad"), TaskExplanation)
    assert why.reason.code == "unreadable"
    reopened.close()


def test_a_plan_that_cannot_be_made_at_all_is_told_as_the_reason(team, monkeypatch):
    team.robot("r1")
    team.run(0.5)

    def faulty(*_):
        raise OverflowError("a defect")

    monkeypatch.setattr(PlanSearch, "_draft", faulty)
    team.submit(Task(id="v", kind="visit", place=Point2D(6.0, 4.0)))
    team.run(1.0)
    monkeypatch.setattr(PlanSearch, "_find_wrong", lambda *_: {})
    team.submit(Task(id="w", kind="visit", place=Point2D(6.0, 4.0)))
    team.run(1.0)
    why = team.ask(task_messages.TASK_EXPLAIN, TaskRequest(id="v"), TaskExplanation)
    assert why.reason.code == "no_plan"
    assert "OverflowError: a defect" in why.now
