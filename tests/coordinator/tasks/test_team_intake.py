"""What robots did without a coordinator, as the coordinator takes it in."""

import pytest

from robrain.coordinator.core.robot_reports import record_ballot
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.protocol.clock import VirtualClock
from robrain.protocol.messages.tasks.consensus_messages import TaskAsked, TaskDone, TaskDropped, TaskHeld, TeamBallot
from robrain.protocol.messages.tasks.task_messages import TaskSubmission
from robrain.protocol.model.ballot import Ballot
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import cancelled

TASK = Task(id="t4", kind="visit", place=Point2D(1.0, 2.0))


def ballot(**fields):
    return TeamBallot(robot="r2", ballot=Ballot(robot="r2", number=1, bids=(), received=()), **fields)


@pytest.mark.parametrize(
    ("is_secured", "submitter", "canceller"),
    [(False, "operator:ann", "operator:bob"), (True, "robot:r2 for operator:ann", "robot:r2 for operator:bob")],
)
def test_a_robot_speaks_in_nobodys_name_where_names_are_vouched_for(is_secured, submitter, canceller):
    book = TaskBook(VirtualClock(), 0, lambda _: None)
    asked = TaskAsked(submission=TaskSubmission(task=TASK, by="operator:ann"), at_ns=0)
    assert record_ballot(book, ballot(asked=[asked]), lambda _: "", is_secured=is_secured)
    assert book.find("t4").by == submitter
    dropped = TaskDropped(id="t4", by="operator:bob", why="not needed")
    assert record_ballot(book, ballot(dropped=[dropped]), lambda _: "", is_secured=is_secured)
    record = book.find("t4")
    assert record.state is TaskState.CANCELLED
    assert record.reason == cancelled(canceller, "not needed")


def test_epochs_of_another_coordinator_are_outbid_and_those_that_none_gives_out_are_passed_over(tmp_path):
    clock = VirtualClock()
    book = TaskBook(clock, 0, lambda _: None)
    for name in ("t1", "t2", "t3", "t4"):
        book.add(Task(id=name, kind="visit", place=Point2D(1.0, 2.0)))
    ahead = book.journal.epoch_ceiling + 60_000
    said = ballot(
        held=[TaskHeld(id="t1", epoch=ahead), TaskHeld(id="t2", epoch=2**53 - 1)],
        done=[TaskDone(id="t3", robot="r2", epoch=ahead + 1), TaskDone(id="t4", robot="r2", epoch=2**53 - 1)],
    )
    record_ballot(book, said, lambda _: "")
    states = [book.find(name).state for name in ("t1", "t2", "t3", "t4")]
    assert states == [TaskState.RUNNING, TaskState.QUEUED, TaskState.DONE, TaskState.QUEUED]
    assert book.journal.epoch_ceiling > ahead + 1
    assert book.journal.new_epoch() > ahead + 1
