"""What is planned_entries for a robot, as the plan's picture has it."""

from robrain.dashboard.html.task_html import gantt_html, planned_entries
from robrain.dashboard.state.shown_robot import ShownRobot
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.border.border import Received
from robrain.protocol.messages.robots.robot_messages import RobotState, TaskStatus
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.tasks.plan_messages import (
    COORDINATOR_CHARGES,
    ChargeSchedule,
    PlannedCharge,
    TaskDecision,
)
from robrain.protocol.messages.tasks.task_messages import RobotVerdict
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
    for task, start_s in (("b", 30.0), ("c", 60.0)):
        bid = RobotVerdict(robot="r1", chosen=True, time_s=25.0)
        view.board.decide(
            TaskDecision(task=task, plan=1, robots=("r1",), start_in_s=start_s, bids=(bid,), stamp_ns=90 * S)
        )
    robot = view.robots["r1"] = ShownRobot("r1", 0)
    robot.state = RobotState(robot="r1", stamp_ns=NOW_NS, **state)  # type: ignore[arg-type]
    return view, robot


def charge(robot: str, from_s: int, until_s: int) -> PlannedCharge:
    return PlannedCharge(
        robot=robot, charger=PLACE, set_out_ns=0, from_ns=from_s * S, until_ns=until_s * S, soc=0.2, to_soc=0.9
    )


def test_planned_tasks_stand_where_the_plan_has_them() -> None:
    view, robot = view_of()
    assert [(one.start_ns // S, one.end_ns // S, one.kind) for one in planned_entries(view, robot, NOW_NS)] == [
        (120, 145, "planned"),
        (150, 175, "planned"),
    ]


def test_task_that_is_held_ready_follows_the_one_that_the_robot_is_at() -> None:
    task = TaskStatus(id="a", epoch=1, state=TaskState.RUNNING, remaining_s=12.0)
    view, robot = view_of(task=task, next_task=TaskStatus(id="b", epoch=2, state=TaskState.OFFERED))
    found = planned_entries(view, robot, NOW_NS)
    assert [(one.start_ns // S, one.end_ns // S, one.kind) for one in found] == [
        (100, 112, "held"),
        (112, 137, "held"),
        (150, 175, "planned"),
    ]
    assert "visit b: held ready" in gantt_html(view)


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
