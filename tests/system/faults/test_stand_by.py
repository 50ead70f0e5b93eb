"""Coordinators that stand by: one takes over when the first has gone, with its journal, and never two at once."""

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
BY = "coordinator: standing by for the coordinator of team default"
TAKEN_OVER_S = 1.5
"""Robots keep their tasks while their coordinator is silent for this long."""


@pytest.fixture
def start(commands, hub):
    endpoint = next(where for where in listening_at(hub) if where.startswith("tcp/"))

    def start(*words: str):
        return commands.start("coordinator", "--connect", endpoint, *words)

    yield start
    commands.stop_all()


def test_one_that_stands_by_takes_over_with_all_tasks_before_robots_let_go_of_theirs(commands, start, wire) -> None:
    first = start()
    commands.line_with(first, UP)
    others = [start("--stand-by"), start("--stand-by")]
    for other in others:
        commands.line_with(other, BY)
    asked = TaskSubmission(task=Task(id="t1", kind="visit", place=Point2D(1.0, 1.0)))
    task = until_answered(lambda: wire.ask(TASK_SUBMIT, asked)).task
    first.send_signal(signal.SIGKILL)
    killed_s = time.monotonic()
    listed = until_answered(lambda: wire.ask(TASK_LIST, TaskFilter()))
    assert time.monotonic() - killed_s < TAKEN_OVER_S
    assert [record.task for record in listed] == [task]
    assert [other.poll() for other in others] == [None, None]
    for other in others:
        other.send_signal(signal.SIGTERM)
    said = sorted(other.communicate(timeout=PATIENCE_S)[0] for other in others)
    assert [UP in text for text in said].count(True) == 1


def test_one_that_hangs_is_succeeded_only_when_it_writes_no_more(commands, start) -> None:
    first = start()
    commands.line_with(first, UP)
    second = start("--stand-by")
    commands.line_with(second, BY)
    first.send_signal(signal.SIGSTOP)
    line = commands.line_with(second, "is locked")
    assert line.endswith("; waiting until it does not any more\n")
    first.send_signal(signal.SIGCONT)
    said, _ = first.communicate(timeout=PATIENCE_S)
    assert first.returncode == 2
    assert "this process hung, and the coordinator of team default is another one now" in said
    commands.line_with(second, UP)
