"""What a task takes at its place becomes time and energy of its job."""

import msgspec
import pytest

from robrain.coordinator.planning.path_lengths import PathLengths
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.problem_builder import build_problem
from robrain.coordinator.planning.snapshot import HANDLING_S
from robrain.protocol.messages.robots.robot_messages import BatteryState
from robrain.protocol.model.energy_model import Work, estimate
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.reasons import SameRobot
from tests.coordinator.planning.snapshots import open_floor_snapshot
from tests.energy_models import energy_model

MODEL = energy_model(5.0, 4.0, 6.0, 2.0, 0.0, packet_j=0.1, usable_j=20_000.0, power_w=5.0, usual_power_w=5.0)
BATTERY = BatteryState(voltage_v=12.0, current_a=0.5, temperature_c=25.0, soc=1.0, remaining_j=30_000.0)
SWEEP = Work(path_m=8.0, turn_rad=3.0, wait_s=2.0, radio_packets=4)


def jobs_of(works, model=MODEL, **held):
    asked = open_floor_snapshot(1, tasks=1)
    members = {
        name: one._replace(state=msgspec.structs.replace(one.state, energy=model, battery=BATTERY))
        for name, one in asked.members.items()
    }
    records = tuple(msgspec.structs.replace(record, **held) for record in asked.records)
    asked = msgspec.structs.replace(asked, members=members, works={"t0": works}, records=records)
    if held:
        asked = msgspec.structs.replace(asked, served_s={"t0": 0.5 * (HANDLING_S + estimate(MODEL, SWEEP).duration_s)})
    return build_problem(asked, PathLengths(None, 0.3, 1.5), PlanningPolicy()).question.jobs[0]


def test_standing_takes_its_time_at_standing_power() -> None:
    job = jobs_of((Work(wait_s=20.0),))
    assert job.service_s == HANDLING_S + 20.0
    assert job.service_j == (HANDLING_S + 20.0) * 5.0


def test_driving_and_turning_at_the_place_take_what_the_robots_model_says() -> None:
    job, found = jobs_of((SWEEP,)), estimate(MODEL, SWEEP)
    assert job.service_s == pytest.approx(HANDLING_S + found.duration_s)
    assert job.service_j == pytest.approx(HANDLING_S * 5.0 + found.mean_j)
    assert found.mean_j > found.duration_s * 5.0  # driving costs more than standing


def test_of_robots_of_two_types_the_dearest_counts() -> None:
    both, alone = jobs_of((Work(wait_s=3.0), SWEEP, Work(path_m=1.0))), jobs_of((SWEEP,))
    assert (both.service_s, both.service_j) == (alone.service_s, alone.service_j)


def test_what_a_running_task_has_done_already_is_taken_off() -> None:
    whole, half = jobs_of((SWEEP,)), jobs_of((SWEEP,), robot="r0", state=TaskState.RUNNING)
    assert half.service_s == pytest.approx(whole.service_s / 2)
    assert half.service_j == pytest.approx(whole.service_j / 2)


def test_a_robot_that_tells_nothing_of_its_energy_is_taken_for_a_small_one() -> None:
    job = jobs_of((SWEEP,), model=None)
    assert job.service_s == HANDLING_S + 2.0 + 2.0 * 8.0
    assert job.service_j == pytest.approx(30.0 * 8.0)


def test_a_job_ends_where_its_robot_will_be() -> None:
    """A delivery ends where its item goes, so the next path begins there."""
    asked = open_floor_snapshot(2, tasks=2)
    asked = msgspec.structs.replace(asked, works={"t0": (Work(path_m=5.0, ends_at=asked.records[1].task.place),)})
    jobs = build_problem(asked, PathLengths(None, 0.3, 1.5), PlanningPolicy()).question.jobs
    assert jobs[0].end_place == jobs[1].place
    assert jobs[1].end_place is None


def test_two_tasks_for_the_same_robot_are_a_pair_and_a_third_one_waits_for_its_robot() -> None:
    asked = open_floor_snapshot(1, tasks=3)
    records = [
        msgspec.structs.replace(record, task=msgspec.structs.replace(record.task, same_robot_as=other))
        for record, other in zip(asked.records, ("", "t0", "t0"), strict=True)
    ]
    running = msgspec.structs.replace(records[0], robot="r0", state=TaskState.RUNNING)
    found = []
    for first in (records[0], running):
        snapshot = msgspec.structs.replace(asked, records=(first, *records[1:]))
        built = build_problem(snapshot, PathLengths(None, 0.3, 1.5), PlanningPolicy())
        found.append(([(job.id, job.same_worker_as, job.after) for job in built.question.jobs], built.waiting))
    assert found == [
        ([("t0", "", ()), ("t1", "t0", ("t0",))], {"t2": SameRobot("t0")}),
        ([("t0", "", ()), ("t1", "", ("t0",)), ("t2", "", ("t0",))], {}),
    ]
