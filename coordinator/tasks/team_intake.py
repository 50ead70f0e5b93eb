"""Accepts the actions of robots on tasks while they received no coordinator."""

from collections.abc import Callable

import msgspec

from robrain.coordinator.tasks.task_book import TaskBook
from robrain.protocol.messages.tasks.consensus_messages import TaskAsked, TeamBallot
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import PlainReason, cancelled


def take_in(
    book: TaskBook,
    said: TeamBallot,
    impossibility: Callable[[Task], str],
    *,
    is_secured: bool = False,
    ahead_ns: int = 0,
) -> bool:
    """Record a robot's tasks and reported ends that no coordinator decided on; return whether any is new.

    A report with an epoch that no coordinator issues is skipped.

    Args:
        book: of the coordinator's tasks.
        said: by a robot.
        impossibility: why a task can never be done; empty if it may be possible.
        is_secured: whether the robot's name is vouched for: its reports on others are then recorded as its own claim.
        ahead_ns: how far the robot's clock is ahead.

    Raises:
        JournalUnwritable: changes that could not be written arrive again with the next ballot.

    """
    version = book.version
    accepted = (_accept(book, said.robot, asked, ahead_ns, is_secured=is_secured) for asked in said.asked)
    new = [task for task in accepted if task is not None]
    for done in said.done:
        record = book.find(done.id)
        if record is not None and record.state.ended:
            book.tell(record)  # robots have not received that, and forget it then
            continue
        if record is None or not book.is_possible(done.epoch):
            continue
        book.know(done.epoch)
        book.record_done_by_team(
            done.id, done.robot, done.epoch, PlainReason(f"{done.robot} did it while it heard no coordinator")
        )
    for held in said.held:
        record = book.find(held.id)
        if record is not None and record.state is TaskState.QUEUED and book.is_possible(held.epoch):
            book.know(held.epoch)
            book.adopt(
                held.id, said.robot, held.epoch, PlainReason(f"{said.robot} began it while it heard no coordinator")
            )
    for dropped in said.dropped:
        record = book.find(dropped.id)
        if record is None:
            continue  # sent again with the task, if robots have accepted it
        if record.state.ended:
            book.tell(record)  # robots forget the cancellation then
        else:
            book.move(
                dropped.id,
                TaskState.CANCELLED,
                cancelled(_by(said.robot, dropped.by, is_secured=is_secured), dropped.why),
            )
    for task in new:
        record = book.find(task.id)
        if record is not None and record.state is TaskState.QUEUED and (why := impossibility(task)):
            book.move(task.id, TaskState.FAILED, PlainReason(cut(why)))
    return book.version != version


def _by(robot: str, claim: str, *, is_secured: bool) -> str:
    """Requester of a task or a cancellation: only the robot vouches for the name that it reports."""
    return cut(f"robot:{robot} for {claim or 'nobody named'}") if is_secured else claim


def _accept(book: TaskBook, robot: str, asked: TaskAsked, ahead_ns: int, *, is_secured: bool) -> Task | None:
    """Add a task that robots have accepted to the book. None if it is there already; robots receive it again."""
    submission = asked.submission
    record = book.find(submission.task.id)
    if record is not None:
        book.tell(record)
        return None
    try:
        task = submission.task_at(asked.at_ns - ahead_ns)
    except (ValueError, msgspec.ValidationError):
        return None  # no robot has accepted that
    reason = PlainReason(f"{robot} had no coordinator and accepted it")
    book.add(task, by=_by(robot, submission.by, is_secured=is_secured), asked=submission.word, reason=reason)
    return task
