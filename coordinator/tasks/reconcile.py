"""Does what the robots say agree with the book? Pure: of a record, a robot and the time, what follows.

A robot tells with each state which task it was last at, with its epoch and how that stands, which one it holds for
after it, and how the one before ended; the journal tells what the book knew at any moment. Between the two, whatever
ended and began anew meanwhile:

| the book says | the robot | then |
|---|---|---|
| anything open | has ended it, same epoch | its word counts (`TaskBook.note_status`) |
| offered, lost contact | is at it, same epoch | running |
| offered | holds it, same epoch | offered |
| running | silent for 1 s, or its token has gone | lost contact |
| lost contact | silent for the lease and a guard | given back |
| running | there, and does not speak of it for 1 s | given back: it has lost it in a restart |
| offered | does not speak of it, for the lease and a guard from the offer | given back |
| another task, or none | is at a task, or holds one | that one is withdrawn |
"""

from collections.abc import Sequence
from typing import NamedTuple

from robrain.coordinator.team.roster import LOST_AFTER_S, Robot
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.messages.robot_messages import TaskStatus
from robrain.protocol.wire.messages.task_messages import TaskRecord
from robrain.protocol.wire.reasons.robots import NotHeard
from robrain.protocol.wire.reasons.tasks import ContactBack, Forgotten, LeaseRanOut, NeverTaken, TaskReason

LEASE_S = 1.5
"""A robot lets go of its task after so long without a word of its coordinator (chosen: three summaries)."""
FREE_AFTER_S = 2.0
"""The task of a robot that is silent is free after this. What is more than the lease is the guard: the robot's host
steps each 20 ms, its last state may be 100 ms old, and a summary may be on its way (chosen)."""
FORGOTTEN_S = 1.0
"""A robot that for this long does not speak of the task it was given has lost it, by a restart for instance."""


class Move(NamedTuple):
    """What a record is to become."""

    state: TaskState
    """QUEUED: given back."""
    reason: TaskReason | None = None


def reconcile(record: TaskRecord, robot: Robot | None, now_ns: int, since_ns: int) -> Move | None:
    """What the silence or the word of a record's robot makes of the record; None if it may stay as it is.

    Args:
        record: an open one that has a robot.
        robot: as the roster knows it; None if it was never heard of.
        now_ns: the time.
        since_ns: since when this coordinator listens. Nobody counts as silent for longer.

    """
    name = record.robot
    heard_ns = max(since_ns, robot.heard_ns if robot is not None and robot.heard_ns is not None else since_ns)
    silent_ns = now_ns - heard_ns
    held_ns = now_ns - max(record.changed_ns, since_ns)
    if robot is not None and robot.is_up(now_ns):
        status = _spoken(record, robot)
        if status is not None:
            return None if status.state.ended or status.state is TaskState.OFFERED else _confirmed(record)
        if record.state is TaskState.OFFERED:
            waits = held_ns <= to_ns(FREE_AFTER_S)
            return None if waits else Move(TaskState.QUEUED, NeverTaken(name))
        return Move(TaskState.QUEUED, Forgotten(name)) if held_ns > to_ns(FORGOTTEN_S) else None
    if silent_ns > to_ns(FREE_AFTER_S) and (record.state is not TaskState.OFFERED or held_ns > to_ns(FREE_AFTER_S)):
        return Move(TaskState.QUEUED, LeaseRanOut(name))
    # A coordinator that begins anew has to have listened for a while before it can miss anybody.
    if record.state is not TaskState.RUNNING or now_ns - since_ns <= to_ns(LOST_AFTER_S):
        return None
    return Move(TaskState.LOST_CONTACT, NotHeard() if robot is None else robot.why_not_up(now_ns))


def _confirmed(record: TaskRecord) -> Move | None:
    if record.state is TaskState.OFFERED:
        return Move(TaskState.RUNNING)
    return Move(TaskState.RUNNING, ContactBack()) if record.state is TaskState.LOST_CONTACT else None


def strays(robot: Robot, records: Sequence[TaskRecord]) -> list[TaskStatus]:
    """Tasks that a robot is at or holds and should not; none if all is as it should be.

    Args:
        robot: one that is there.
        records: the open tasks that the book has for it.

    """
    state = robot.state
    if state is None:
        return []
    found = []
    at, held = state.task, state.next_task
    # A robot that was offered another task is about to leave this one: the offer itself takes its place. But one that
    # it holds waits for the end of this one.
    is_to_end = all(held is not None and _is(record, held) for record in records)
    if at is not None and not at.state.ended and is_to_end and not _has(records, at):
        found.append(at)
    if held is not None and not _has(records, held):
        found.append(held)
    return found


def _spoken(record: TaskRecord, robot: Robot) -> TaskStatus | None:
    state = robot.state
    if state is None:
        return None
    told = (state.task, state.next_task, state.task_before)
    return next((status for status in told if status is not None and _is(record, status)), None)


def _is(record: TaskRecord, status: TaskStatus) -> bool:
    return (record.task.id, record.epoch) == (status.id, status.epoch)


def _has(records: Sequence[TaskRecord], status: TaskStatus) -> bool:
    return any(_is(record, status) for record in records)
