"""What is planned_entries for a robot, as the plan's picture has it."""

from robrain.dashboard.html.task_html import gantt_html, planned_entries
from robrain.dashboard.state.shown_robot import ShownRobot
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.border.border import Received
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.tasks.plan_messages import (
    COORDINATOR_CHARGES,
    ChargeSchedule,
    PlannedCharge,
    TaskEstimates,
)
from robrain.protocol.messages.tasks.task_messages import TaskEstimate
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState

PLACE = Point2D(1.0, 2.0)
S = 1_000_000_000
NOW_NS = 100 * S


def view_of(**state: object) -> tuple[ShownTeam, ShownRobot]:
    """One robot at task `a`, with `b` and `c` planned for it."""
    view = ShownTeam()
    for task, status in (("a", TaskState.RUNNING), ("b", TaskState.QUEUED), ("c", TaskState.QUEUED)):
        view.board.handle(
            TaskEvent(task=Task(id=task, kind="visit", place=PLACE), state=status, robot="r1", stamp_ns=80 * S)
        )
    times_s = {"a": (-10.0, 22.0), "b": (30.0, 55.0), "c": (60.0, 85.0)}
    tasks = tuple(estimate(task, *times) for task, times in times_s.items())
    view.board.estimates = TaskEstimates(stamp_ns=90 * S, tasks=(*tasks, estimate("gone", 0.0, 90.0)))
    robot = view.robots["r1"] = ShownRobot("r1", 0)
    robot.state = RobotState(robot="r1", stamp_ns=NOW_NS, **state)  # type: ignore[arg-type]
    return view, robot


def estimate(task: str, starts_in_s: float, ends_in_s: float) -> TaskEstimate:
    return TaskEstimate(
        task=task,
        robot="r1",
        starts_in_s=starts_in_s,
        arrives_in_s=ends_in_s,
        ends_in_s=ends_in_s,
        ends_low_s=ends_in_s,
        ends_high_s=ends_in_s,
        energy_j=1.0,
    )


def charge(robot: str, from_s: int, until_s: int) -> PlannedCharge:
    return PlannedCharge(
        robot=robot, charger=PLACE, set_out_ns=0, from_ns=from_s * S, until_ns=until_s * S, soc=0.2, to_soc=0.9
    )


def test_tasks_stand_at_their_expected_times() -> None:
    view, robot = view_of()
    assert [(one.start_ns // S, one.end_ns // S, one.kind) for one in planned_entries(view, robot, NOW_NS)] == [
        (100, 112, "held"),
        (120, 145, "planned"),
        (150, 175, "planned"),
    ]
    assert planned_entries(view, ShownRobot("r2", 1), NOW_NS) == []
    assert [one.end_ns // S for one in planned_entries(view, robot, 120 * S)] == [145, 175]


def test_charging_is_drawn_from_when_to_when_and_forgotten_once_it_is_past() -> None:
    view, robot = view_of()
    schedule = ChargeSchedule(charges=(charge("r1", 90, 300), charge("r2", 90, 300), charge("r1", 10, 20)))
    key = COORDINATOR_CHARGES.key("default")
    view.apply(Received(COORDINATOR_CHARGES, key, {}, schedule), 0.0)
    (charging,) = [one for one in planned_entries(view, robot, NOW_NS) if one.kind == "charge"]
    assert (charging.start_ns, charging.end_ns) == (NOW_NS, 300 * S)
    html = gantt_html(view)
    assert "charging to 90 %" in html
    assert "in 3 min" in html
