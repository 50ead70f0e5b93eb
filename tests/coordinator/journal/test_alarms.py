"""Alarms of rules: kept with the tasks that they were made for, or not at all."""

import sqlite3

import pytest
from msgspec.structs import replace

from robrain.coordinator.journal.journal import Journal
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.messages.team.standing_messages import JournalAlarm
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState

ALARM = JournalAlarm(rule="heat", source="m1", measured_ns=10, fired_ns=20)
ARMED = replace(ALARM, is_armed=True)


def record(task_id="t1"):
    return TaskRecord(task=Task(id=task_id, kind="visit", place=Point2D(1.0, 2.0)), state=TaskState.QUEUED)


def test_a_task_and_its_alarm_outlast_the_process(tmp_path):
    journal = Journal(tmp_path / "journal")
    journal.accept(record(), alarm=ALARM)
    journal.record_alarm(JournalAlarm(rule="heat", source="m2", measured_ns=11, fired_ns=21, is_armed=True))
    journal.close()
    again = Journal(tmp_path / "journal")
    assert again.alarms() == [ALARM, JournalAlarm(rule="heat", source="m2", measured_ns=11, fired_ns=21, is_armed=True)]
    assert again.find("t1") is not None
    again.close()


def test_without_the_task_there_is_no_alarm():
    journal = Journal()
    journal.accept(record())
    with pytest.raises(sqlite3.IntegrityError):
        journal.accept(record(), alarm=ALARM)
    assert journal.alarms() == []
    journal.close()


def test_a_source_has_one_alarm_the_last():
    journal = Journal()
    journal.record_alarm(ALARM)
    journal.record_alarm(ARMED)
    assert journal.alarms() == [ARMED]
    journal.keep_alarms([])
    assert journal.alarms() == []
    journal.close()


def test_a_journal_of_before_there_were_rules_gets_their_table(tmp_path):
    path = tmp_path / "journal"
    journal = Journal(path)
    journal.accept(record())
    journal.close()
    old = sqlite3.connect(path)
    old.execute("DROP TABLE alarm")
    old.execute("PRAGMA user_version = 3")
    old.commit()
    old.close()
    again = Journal(path)
    assert again.alarms() == []
    assert again.find("t1") is not None
    again.close()
