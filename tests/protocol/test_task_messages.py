import inspect
from pathlib import Path

import msgspec
import pytest

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.task import TaskState, Visit
from robrain.protocol.wire import task_messages

GOLDEN = Path(__file__).parent / "golden" / "task_requests"
"""One example of each, as it is on the wire and in journals. Changed bytes break peers and journals: think first."""

TASK = Visit(id="task-7", place=Point2D(1.5, -2.0), priority=2.0)
RECORD = task_messages.TaskRecord(
    task=TASK,
    state=TaskState.DONE,
    robot="r1",
    epoch=12,
    why="there",
    result={"energy_j": 12.5},
    changed_ns=1_500_000_000,
    change=41,
    submitted_ns=1_400_000_000,
    by="ann",
    own=True,
    attempts=1,
)
EXAMPLES = [
    task_messages.TaskSubmission(task=TASK, by="ann", earliest_in_s=1.0, deadline_in_s=60.0),
    RECORD,
    task_messages.TaskRequest(id="task-7", by="ann", why="too late"),
    task_messages.TaskFilter(
        states=[TaskState.DONE], kinds=["visit"], robot="r1", by="ann", own=True, limit=10
    ),
    task_messages.TaskChange(
        number=41, stamp_ns=1_500_000_000, state=TaskState.DONE, robot="r1", epoch=12, why="there"
    ),
    task_messages.RobotVerdict(
        robot="r1", chosen=True, why_not="r2 is nearer", distance_m=1.5, energy_j=20.0, time_s=3.0
    ),
    task_messages.TaskWhy(
        record=RECORD,
        now="it is done at r1: there",
        robots=[task_messages.RobotVerdict(robot="r1", chosen=True)],
        decided_ns=1_450_000_000,
        changes=[task_messages.TaskChange(number=41, stamp_ns=1_500_000_000, state=TaskState.DONE)],
    ),
]  # fmt: skip
each = pytest.mark.parametrize("message", EXAMPLES, ids=lambda message: type(message).__name__)


def golden(message):
    return (GOLDEN / f"{type(message).__name__}.json").read_bytes()


@each
def test_the_bytes_are_those_of_the_golden_file_and_decode_to_the_same(message):
    assert msgspec.json.encode(message) == golden(message)
    assert msgspec.json.decode(golden(message), type=type(message)) == message


@each
def test_an_example_says_something_in_every_field(message):
    assert set(msgspec.json.decode(golden(message))) == set(type(message).__struct_fields__)


@each
def test_older_peers_may_leave_out_what_has_a_default_and_newer_ones_say_more(message):
    required = {field.encode_name for field in msgspec.structs.fields(type(message)) if field.required}
    full = msgspec.json.decode(golden(message))
    older = {name: value for name, value in full.items() if name in required}
    decoded = msgspec.json.decode(msgspec.json.encode({**older, "from_a_newer_peer": 1}), type=type(message))
    assert all(getattr(decoded, name) == getattr(message, name) for name in required)


def test_everything_that_is_said_about_tasks_has_an_example():
    structs = {kind for _, kind in inspect.getmembers(task_messages, inspect.isclass)
               if issubclass(kind, msgspec.Struct) and kind.__module__ == task_messages.__name__}  # fmt: skip
    assert structs == {type(message) for message in EXAMPLES}
    assert {path.stem for path in GOLDEN.glob("*.json")} == {kind.__name__ for kind in structs}
