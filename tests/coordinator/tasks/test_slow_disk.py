"""A submission is answered once it is on the disk; the robot does not wait for that."""

import errno
import threading
from pathlib import Path

import pytest

from robrain.coordinator.journal.journal import Journal
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.tasks.task_messages import TASK_SUBMIT, TaskRecord, TaskSubmission
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.waiting import PATIENCE_S, until

TASK = Task(id="t1", kind="visit", place=Point2D(6.0, 4.0))


class Disk:
    """Is done when a test says so."""

    def __init__(self) -> None:
        self.is_ready = threading.Event()
        self.error: OSError | None = None

    def sync(self, _file: int) -> None:
        assert self.is_ready.wait(PATIENCE_S)
        if self.error is not None:
            raise self.error


class Submitter(threading.Thread):
    """Somebody who submits a task and waits for the answer, which a lockstep team gives in its step."""

    def __init__(self, team) -> None:
        super().__init__(daemon=True)
        self._asker = team.endpoint()
        self.answer: TaskRecord | CallError | None = None

    def run(self) -> None:
        try:
            self.answer = self._asker.ask(TASK_SUBMIT, TaskSubmission(task=TASK), timeout_s=PATIENCE_S)
        except CallError as error:
            self.answer = error


@pytest.fixture
def disk():
    return Disk()


@pytest.fixture
def slow_team(team, disk: Disk, tmp_path: Path):
    """A team whose coordinator's journal is on a disk that hangs; one robot stands there."""
    journal = Journal(tmp_path / "team.journal", sync=disk.sync)
    team.begin(journal)
    team.settle()
    yield team
    disk.is_ready.set()
    journal.close()


def submit(team) -> Submitter:
    """Submit from elsewhere; returns once the coordinator has the task, or should have it."""
    submitter = Submitter(team)
    submitter.start()
    until(lambda: team.coordinator.tasks.find("t1"), "the task does not arrive", step=lambda: team.run(0.02))
    return submitter


def test_robot_is_at_its_task_before_a_slow_disk_has_it_and_the_answer_comes_after(slow_team, disk: Disk):
    submitter = submit(slow_team)
    slow_team.run(0.3)
    assert [offer.task.id for offer in slow_team.robots[0].offers] == ["t1"]
    assert slow_team.states() == {"t1": TaskState.RUNNING}
    assert submitter.is_alive()
    assert submitter.answer is None
    disk.is_ready.set()
    submitter.join(PATIENCE_S)
    assert isinstance(submitter.answer, TaskRecord)
    assert (submitter.answer.task, submitter.answer.state) == (TASK, TaskState.QUEUED)


def test_the_same_submission_again_is_answered_no_sooner_than_the_first(slow_team, disk: Disk):
    both = [submit(slow_team), submit(slow_team)]
    slow_team.run(0.3)
    for _ in range(20):
        slow_team.run(0.02)
        both[1].join(0.01)
    assert [one.answer for one in both] == [None, None]
    disk.is_ready.set()
    for one in both:
        one.join(PATIENCE_S)
        assert isinstance(one.answer, TaskRecord)
    assert len(slow_team.robots[0].offers) == 1


def test_submission_that_the_disk_may_not_have_is_answered_with_what_that_means(slow_team, disk: Disk):
    disk.error = OSError(errno.EIO, "Input/output error")
    disk.is_ready.set()
    submitter = submit(slow_team)
    submitter.join(PATIENCE_S)
    assert isinstance(submitter.answer, CallError)
    assert submitter.answer.code is ErrorCode.FAILED
    assert submitter.answer.message.startswith("task t1 is accepted, but a power cut may lose it: ")
    disk.error = None
    again = submit(slow_team)
    until(lambda: again.answer, "there is no answer", step=lambda: slow_team.run(0.02))
    assert isinstance(again.answer, TaskRecord)
