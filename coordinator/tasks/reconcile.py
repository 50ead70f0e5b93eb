"""Compares the book with the robots' states. Pure: from a record, a robot and the time, the next state.

With each state a robot reports three things. These are its last task with epoch and status, the task that it holds for
later, and the end of the one before. The journal has the book's state at any moment. Together they determine the
next state, whichever process restarted meanwhile. By the state in the book, and the robot:

- Anything open, which the robot has ended with the same epoch: its report counts (`TaskBook.record_status`).
- Offered, or lost contact, and the robot is doing it with the same epoch: running.
- Offered, and the robot holds it with the same epoch: offered.
- Running, and the robot is silent for 1 s, or its token is gone: lost contact.
- Lost contact, and the robot is silent for the lease and a guard time: given back.
- Running, and the robot is present and does not report it for 1 s: given back, for example after a restart.
- Offered, and the robot does not report it for the lease and a guard time: given back.
- Another task, or none, and the robot is doing a task, or holds one: that task is withdrawn.
"""

from collections.abc import Sequence
from typing import NamedTuple

import msgspec

from robrain.coordinator.team.roster import Robot
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.robot_messages import TaskStatus
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.tasks.task import FREE_AFTER_S, LEASE_S, LOST_AFTER_S, TaskState
from robrain.protocol.reasons import LeaseRanOut, NoState, TaskReason, plain

FORGOTTEN_S = 1.0
"""A robot that does not report its assigned task for this long has lost it, for example in a restart."""

OFFER_ARRIVES_S = 0.5
"""An offer that is older and not accepted was lost, so it ends nothing that the robot should not do."""


class StateChange(NamedTuple):
    """A record's next state."""

    state: TaskState
    """QUEUED: given back."""
    reason: TaskReason | None = None


def reconcile(
    record: TaskRecord, robot: Robot | None, now_ns: int, since_ns: int, team_goes_on_s: float = 0.0
) -> StateChange | None:
    """Return a record's next state, from its robot's reports or silence; None if it stays as it is.

    Args:
        record: an open one with a robot.
        robot: from the roster; None if it is unknown.
        now_ns: the time.
        since_ns: since when this coordinator listens. No robot counts as silent for longer.
        team_goes_on_s: time for which robots of the team continue without a coordinator; counts for one that this
            coordinator has not received.

    """
    name = record.robot
    free_after_s = FREE_AFTER_S
    continues_for_s = team_goes_on_s if robot is None or robot.state is None else robot.state.continues_for_s
    if continues_for_s is not msgspec.UNSET:
        free_after_s = max(FREE_AFTER_S, continues_for_s + FREE_AFTER_S - LEASE_S)
    received_ns = max(since_ns, robot.received_ns if robot is not None and robot.received_ns is not None else since_ns)
    silent_ns = now_ns - received_ns
    held_ns = now_ns - max(record.changed_ns, since_ns)
    if robot is not None and robot.is_up(now_ns):
        status = _spoken(record, robot)
        if status is not None:
            return None if status.state.ended or status.state is TaskState.OFFERED else _confirmed(record)
        if record.state is TaskState.OFFERED:
            waits = held_ns <= to_ns(FREE_AFTER_S)
            unanswered = plain("never_taken", f"{name} never said that it took it", robot=name)
            return None if waits else StateChange(TaskState.QUEUED, unanswered)
        forgotten = plain("forgotten", f"{name} knows nothing of it", robot=name)
        return StateChange(TaskState.QUEUED, forgotten) if held_ns > to_ns(FORGOTTEN_S) else None
    if silent_ns > to_ns(free_after_s) and (record.state is not TaskState.OFFERED or held_ns > to_ns(FREE_AFTER_S)):
        return StateChange(TaskState.QUEUED, LeaseRanOut(name))
    # A restarted coordinator must have listened for a while before silence counts.
    if record.state is not TaskState.RUNNING or now_ns - since_ns <= to_ns(LOST_AFTER_S):
        return None
    return StateChange(TaskState.LOST_CONTACT, NoState() if robot is None else robot.down_reason(now_ns))


def _confirmed(record: TaskRecord) -> StateChange | None:
    if record.state is TaskState.OFFERED:
        return StateChange(TaskState.RUNNING)
    if record.state is TaskState.LOST_CONTACT:
        return StateChange(TaskState.RUNNING, plain("contact_back", "it is back"))
    return None


def strays(robot: Robot, records: Sequence[TaskRecord], now_ns: int) -> list[TaskStatus]:
    """Return the tasks that a robot does or holds and should not.

    Args:
        robot: a present one.
        records: the open tasks that the book has for it.
        now_ns: the time.

    """
    state = robot.state
    if state is None:
        return []
    found = []
    at, held = state.task, state.next_task
    # An offer of another task replaces the running one by itself. A held task, however, waits for the end of the
    # running one.
    is_to_end = all(
        (held is not None and _is(record, held))
        or (record.state is TaskState.OFFERED and now_ns - record.changed_ns > to_ns(OFFER_ARRIVES_S))
        for record in records
    )
    if at is not None and not at.state.ended and is_to_end and not _has(records, at):
        found.append(at)
    if held is not None and not _has(records, held):
        found.append(held)
    return found


def _spoken(record: TaskRecord, robot: Robot) -> TaskStatus | None:
    state = robot.state
    if state is None:
        return None
    for status in (state.task, state.next_task, state.task_before):
        if status is not None and status.id == record.task.id and status.epoch == record.epoch:
            return status
    return None


def _is(record: TaskRecord, status: TaskStatus) -> bool:
    return record.task.id == status.id and record.epoch == status.epoch


def _has(records: Sequence[TaskRecord], status: TaskStatus) -> bool:
    return any(_is(record, status) for record in records)
