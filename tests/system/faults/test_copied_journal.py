"""A coordinator that stands by with a journal of its own: nothing acknowledged is lost with the other's machine."""

import signal
import time

import pytest

from robrain.protocol.messages.tasks.task_messages import TaskFilter, TaskSubmission
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.table.topics import TASK_LIST, TASK_SUBMIT
from robrain.protocol.wire.session import listening_at
from tests.asking import until_answered
from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.system

UP = "coordinator: of team default; Ctrl-C"
IN_STEP = "in step: nothing is acknowledged that is not in the copy"
GONE = "the coordinator is silent. The copy of its journal: it was in step"


@pytest.fixture
def start(commands, hub):
    endpoint = next(where for where in listening_at(hub) if where.startswith("tcp/"))

    def start(*words: str):
        return commands.start("coordinator", "--connect", endpoint, *words)

    yield start
    commands.stop_all()


def test_all_that_was_acknowledged_is_in_the_copy_after_a_kill_and_the_copy_is_gone_on_from(
    commands, start, wire, tmp_path
) -> None:
    first_file, copy = str(tmp_path / "first.journal"), str(tmp_path / "copy.journal")
    first = start("--journal", first_file)
    commands.line_with(first, UP)
    second = start("--stand-by", "--journal", copy)
    commands.line_with(second, IN_STEP)
    asked = [TaskSubmission(task=Task(id=f"t{n}", kind="visit", place=Point2D(1.0, 1.0))) for n in range(20)]
    began_s = time.monotonic()
    tasks = [until_answered(lambda one=one: wire.ask(TASK_SUBMIT, one)).task for one in asked]
    assert time.monotonic() - began_s < PATIENCE_S
    first.send_signal(signal.SIGKILL)
    line = commands.line_with(second, GONE)
    assert f"start robrain coordinator --journal {copy}" in line
    second.send_signal(signal.SIGTERM)
    second.communicate(timeout=PATIENCE_S)
    third = start("--journal", copy)
    commands.line_with(third, UP)
    listed = until_answered(lambda: wire.ask(TASK_LIST, TaskFilter()))
    assert [record.task for record in listed] == tasks
    # What the first had comes back as one that stands by: its own file becomes a copy, and stays beside it.
    again = start("--stand-by", "--journal", first_file)
    commands.line_with(again, IN_STEP)
    assert (tmp_path / "first.journal.before-1").exists()
