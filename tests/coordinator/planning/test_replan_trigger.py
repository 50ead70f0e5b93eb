"""What asks for another plan, and what does not yet."""

import msgspec
import pytest

from robrain.coordinator.planning.planning import DEARER_SHARE, DRAINED_SHARE, GROWN_SHARE, PlanInputs
from robrain.coordinator.planning.snapshot import PlanningRobot
from robrain.protocol.messages.robots.robot_messages import BatteryState, RobotState
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.energy_model import EnergyModel
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.coordinator.planning.worlds import model

HOME = Point2D(0.0, 0.0)
J_PER_M = 40.0
USABLE_J = 50_000.0
FULL_J = 100_000.0
AREA_M2 = 100.0
LIMIT_M2 = AREA_M2 * (1.0 + GROWN_SHARE)


def energy(j_per_m: float = J_PER_M, usable_j: float = USABLE_J) -> EnergyModel:
    """A robot whose standing takes nothing."""
    return msgspec.structs.replace(model(usable_j), coefficients=(0.0, 0.0, j_per_m, 0.0, 0.0))


def member(
    j_per_m: float = J_PER_M, usable_j: float = USABLE_J, *, offers=frozenset({"visit"}), chargers=(), free_ns: int = 0
) -> PlanningRobot:
    battery = BatteryState(
        voltage_v=16.0, current_a=1.0, temperature_c=20.0, soc=0.5, remaining_j=0.5 * FULL_J,
        remaining_low_j=usable_j, remaining_high_j=0.5 * FULL_J, charging=False,
    )  # fmt: skip
    state = RobotState(robot="r1", pose=Pose2D(0.0, 0.0, 0.0), energy=energy(j_per_m, usable_j), battery=battery)
    return PlanningRobot(state, offers, chargers, HOME, free_ns)


def record(name: str, state: TaskState = TaskState.QUEUED, robot: str = "") -> TaskRecord:
    return TaskRecord(task=Task(id=name, kind="visit", place=HOME), state=state, robot=robot)


def inputs(records=("t1",), members=None, pauses=(("t1", "r2"),), area_m2: float = AREA_M2) -> PlanInputs:
    """Of a plan for r1 and the task t1, which r2 refused, unless stated otherwise."""
    records = [record(one) if isinstance(one, str) else one for one in records]
    return PlanInputs(records, {"r1": member()} if members is None else members, dict.fromkeys(pauses), area_m2)


def cause(before: PlanInputs, *, left_out: int = 0, **now) -> str:
    return before.cause(inputs(**now), left_out=left_out)


@pytest.mark.parametrize(
    ("now", "expected"),
    [
        ({}, ""),
        ({"records": ["t1", "t2"]}, "t2 is queued"),
        ({"records": []}, "t1 has ended"),
        ({"records": [record("t1", TaskState.OFFERED, "r1")]}, "t1 is running"),
        ({"records": [f"t{number}" for number in range(1, 6)]}, "t2 is queued, t3 is queued, t4 is queued and 1 more"),
        ({"members": {"r1": member(), "r3": member(), "r0": member()}}, "r0 is there; r3 is there"),
        ({"members": {"r2": member()}}, "r2 is there; r1 is out"),
        ({"members": {"r1": member(offers=frozenset())}}, "r1 can do other things than before"),
        ({"members": {"r1": member(chargers=(HOME,))}}, "r1 can do other things than before"),
        ({"members": {"r1": member(free_ns=1)}}, "r1 can do other things than before"),
        ({"pauses": ()}, "whether r2 may be asked for t1"),
        ({"pauses": (("t1", "r2"), ("t1", "r1"))}, "whether r1 may be asked for t1"),
        # A larger map counts only while a task is left out.
        ({"area_m2": LIMIT_M2, "left_out": 1}, ""),
        ({"area_m2": LIMIT_M2 + 1.0, "left_out": 1}, "the map has grown to 106 m²"),
        ({"area_m2": LIMIT_M2 + 1.0}, ""),
    ],
)
def test_a_change_since_the_plan_is_its_cause(now, expected):
    assert cause(inputs(), **now) == expected


def test_a_task_that_was_begun_as_planned_is_no_news():
    before = inputs()
    before.begun("t1", "r1")
    before.begun("t9", "r1")
    assert cause(before, records=[record("t1", TaskState.OFFERED, "r1")]) == ""
    assert cause(before, records=[record("t1", TaskState.RUNNING, "r2")]) == "t1 is running"


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_costs_and_energy_that_have_changed_by_more_than_a_share_are_news(sign):
    limit = J_PER_M * (1.0 + sign * DEARER_SHARE)
    assert cause(inputs(), members={"r1": member(limit)}) == ""
    beyond = limit + sign * 0.1
    assert cause(inputs(), members={"r1": member(beyond)}) == f"r1 takes {beyond:.1f} J a metre, and took 40.0 J"
    limit = USABLE_J + sign * DRAINED_SHARE * FULL_J
    assert cause(inputs(), members={"r1": member(usable_j=limit)}) == ""
    beyond = limit + sign
    assert cause(inputs(), members={"r1": member(usable_j=beyond)}) == f"r1 has {beyond:.0f} J left, and had 50000 J"


def test_an_empty_battery_has_a_capacity_as_well():
    """What is left of 1 % tells what it would hold if full."""
    drained = member(usable_j=USABLE_J - 19.0)
    battery = msgspec.structs.replace(drained.state.battery, soc=0.0, remaining_j=10.0)
    drained = drained._replace(state=msgspec.structs.replace(drained.state, battery=battery))
    assert cause(inputs(), members={"r1": drained}) == ""
    drained = drained._replace(state=msgspec.structs.replace(drained.state, energy=energy(usable_j=USABLE_J - 21.0)))
    assert cause(inputs(), members={"r1": drained}) == "r1 has 49979 J left, and had 50000 J"


def test_the_first_map_is_news():
    assert cause(inputs(area_m2=0.0), area_m2=0.0) == ""
    assert cause(inputs(area_m2=0.0), area_m2=3.0) == "the map has grown to 3 m²"


def test_without_tasks_only_who_is_there_is_news():
    nothing = inputs([], pauses=())
    changed = {"r1": member(2 * J_PER_M, 0.5 * USABLE_J, free_ns=1)}
    assert cause(nothing, records=[], members=changed, pauses=[("t1", "r1")], area_m2=9 * AREA_M2, left_out=1) == ""
    assert cause(nothing, records=[], members={}) == "r1 is out"
