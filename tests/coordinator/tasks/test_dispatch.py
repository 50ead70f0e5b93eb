"""Who gets which task when nobody plans."""

from robrain.coordinator.planning.plan_executor import dispatch
from robrain.coordinator.tasks.eligibility import FIRST_PAUSE_S, LONGEST_PAUSE_S, TaskPauses
from robrain.coordinator.team.roster import Robot
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import OutOfReach, Refused, RobotReason, lacks_plugins, no_path


def task(name: str, x_m: float, submitted_ns: int = 0, **fields) -> TaskRecord:
    made = Task(id=name, kind="visit", place=Point2D(x_m, 0.0), **fields)
    return TaskRecord(task=made, state=TaskState.QUEUED, submitted_ns=submitted_ns)


def robot(name: str, x_m: float | None) -> Robot:
    made = Robot(name)
    made.state = RobotState(robot=name, pose=None if x_m is None else Pose2D(x_m, 0.0, 0.0))
    return made


def free(_task, _robot) -> None:
    return None


def test_the_nearest_able_robot_gets_the_task() -> None:
    robots = [robot("r1", 0.0), robot("r2", 4.0), robot("r3", None), robot("r4", 4.5)]
    wanted = task("t1", 5.0)

    def refusal(_task: TaskRecord, one: Robot) -> RobotReason | None:
        return lacks_plugins(("camera",)) if one.name == "r4" else None

    assert dispatch([wanted], robots, refusal) == [("t1", "r2")]


def test_priority_goes_before_deadline_and_deadline_before_age() -> None:
    ready = [
        task("late", 0.0, 1),
        task("old", 0.0, 0),
        task("soon", 0.0, 2, deadline_ns=9),
        task("dear", 0.0, 3, priority=2.0),
    ]
    for order in (["dear"], ["dear", "soon"], ["dear", "soon", "old"], ["dear", "soon", "old", "late"]):
        robots = [robot(f"r{number}", 0.0) for number in range(len(order))]
        assert [name for name, _ in dispatch(ready, robots, free)] == order


def test_no_robot_gets_two_tasks_and_no_task_two_robots() -> None:
    robots = [robot("r1", 0.0), robot("r2", 10.0)]
    ready = [task("t1", 0.0), task("t2", 1.0), task("t3", 2.0)]
    assert dispatch(ready, robots, free) == [("t1", "r1"), ("t2", "r2")]


def test_who_refused_is_asked_again_after_growing_pauses() -> None:
    backoff = TaskPauses()
    now_ns, pauses = 0, []
    for _ in range(8):
        backoff.record("t1", "r1", Refused(no_path()), now_ns)
        pause_s = FIRST_PAUSE_S
        while backoff.pause_reason("t1", "r1", now_ns + to_ns(pause_s)):
            pause_s += 1.0
        pauses.append(pause_s)
        now_ns += to_ns(pause_s)
    assert pauses == [2.0, 4.0, 8.0, 16.0, 32.0, LONGEST_PAUSE_S, LONGEST_PAUSE_S, LONGEST_PAUSE_S]
    assert backoff.pause_reason("t1", "r2", 0) is None
    assert backoff.pause_reason("t2", "r1", 0) is None
    backoff.record("t2", "r1", OutOfReach(Point2D(1.0, 2.0)), 0)  # each try takes the robot out of contact
    assert backoff.pause_reason("t2", "r1", to_ns(LONGEST_PAUSE_S) - 1) is not None
