"""What is said about tasks: one of each message, all fields filled, as on the wire and in journals.

Changed bytes break peers and journals: think first.
"""

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.messages.tasks import task_messages
from robrain.protocol.wire.reasons import robots, tasks
from robrain.protocol.wire.reasons.reason import Said

TASK = Task(id="task-7", kind="visit", place=Point2D(1.5, -2.0), priority=2.0)
RECORD = task_messages.TaskRecord(
    task=TASK,
    state=TaskState.DONE,
    robot="r1",
    epoch=12,
    why="r2 failed: blocked; attempt 1 of 3",
    result={"energy_j": 12.5},
    changed_ns=1_500_000_000,
    change=41,
    submitted_ns=1_400_000_000,
    by="ann",
    own=True,
    attempts=1,
    reason=tasks.RobotOut("r2", robots.Failed("blocked"), attempt=1, attempts=3),
)
EXAMPLES = [
    task_messages.TaskSubmission(task=TASK, by="ann", earliest_in_s=1.0, deadline_in_s=60.0),
    RECORD,
    task_messages.TaskRequest(id="task-7", by="ann", why="too late"),
    task_messages.TaskFilter(
        states=[TaskState.DONE], kinds=["visit"], robot="r1", by="ann", own=True, limit=10
    ),
    task_messages.KnownKind(
        kind="sweep", doc="Sweeps an area.", parameters={"type": "object", "properties": {}}, robots=["r1", "r2"]
    ),
    task_messages.TaskChange(
        number=41, stamp_ns=1_500_000_000, state=TaskState.DONE, robot="r1", epoch=12, why="there", reason=Said("there")
    ),
    task_messages.RobotVerdict(
        robot="r1", chosen=True, why_not="r2 is nearer", reason=robots.AnotherNearer("r2"),
        distance_m=1.5, energy_j=20.0, time_s=3.0,
    ),
    task_messages.TaskWhy(
        record=RECORD,
        now="it is done at r1: there",
        reason=Said("there"),
        robots=[task_messages.RobotVerdict(robot="r1", chosen=True)],
        decided_ns=1_450_000_000,
        changes=[task_messages.TaskChange(number=41, stamp_ns=1_500_000_000, state=TaskState.DONE)],
        trace="4bf92f3577b34da6a3ce929d0e0e4736",
    ),
    task_messages.TaskDryRun(
        task=TASK,
        refused="there is another task task-7: priority is 2.0, not 3.0",
        known=TaskState.DONE,
        waits="it may not begin before 4.0 s from now",
        reason=tasks.NotBefore(4.0),
        robots=[task_messages.RobotVerdict(robot="r1", distance_m=1.5, energy_j=20.0, time_s=3.0)],
        ahead=2,
    ),
]  # fmt: skip
