import pytest

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.sim.faults.process import JournalDisk


def record(name):
    return TaskRecord(task=Task(id=name, kind="visit", place=Point2D(0.0, 0.0)), state=TaskState.QUEUED)


def test_each_life_of_a_coordinator_goes_on_where_the_one_before_was_killed():
    disk = JournalDisk()
    for life, name in enumerate(("t1", "t2", "t3")):
        journal = disk.open()
        assert len(journal.open_records()) == life
        journal.accept(record(name))
        disk.pull()
    assert [one.task.id for one in disk.open().open_records()] == ["t1", "t2", "t3"]


def test_nothing_is_written_while_the_disk_is_full():
    disk = JournalDisk()
    journal = disk.open()
    disk.is_full = True
    with pytest.raises(JournalUnwritable, match="database or disk is full"):
        journal.accept(record("t1"))
    disk.is_full = False
    journal.accept(record("t2"))
    assert [one.task.id for one in journal.open_records()] == ["t2"]
