"""Executes the plan: offers due tasks, publishes why tasks are left out, and fails those left out for too long."""

from typing import TYPE_CHECKING

from robrain.coordinator.planning.planning import Planning
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.protocol.clock import to_ns
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.reasons import NearestOut, PlanReason, TaskReason, needed_for, plain

if TYPE_CHECKING:
    from robrain.coordinator.tasks.task_lifecycle import TaskLifecycle

OFFERS_MAX = 16
"""Offers per step: each is journalled first, and the team must not wait for that."""
TELL_NS = to_ns(5.0)
"""Interval between checks of left-out tasks while the plan stays the same."""


class PlanExecutor:
    """Executes plans.

    Args:
        planning: makes them.
        lifecycle: of the tasks.
        book: of the tasks.

    """

    def __init__(self, planning: Planning, lifecycle: "TaskLifecycle", book: TaskBook) -> None:
        self._planning = planning
        self._lifecycle = lifecycle
        self._book = book
        self._published_number = 0
        self._publish_ns = 0

    def step(self, now_ns: int) -> bool:
        """Offer due tasks to robots that can take them now; a robot that explores gives that up.

        Returns:
            Whether more is to be offered, at the next step.

        """
        book, lifecycle, planning = self._book, self._lifecycle, self._planning
        with lifecycle.as_far_as_written(now_ns):
            self._publish_left_out(now_ns)
            for count, (task_id, robot, after) in enumerate(planning.due(now_ns)):
                if count == OFFERS_MAX:
                    return True
                if after and not lifecycle.may_be_next(robot, after):
                    continue
                at = book.of_robot(robot)
                if at is not None and not after:
                    book.move(at.task.id, TaskState.CANCELLED, needed_for(robot, task_id))
                lifecycle.record_decision(task_id, [robot], now_ns)
                lifecycle.offer(task_id, robot, now_ns, after=after)
                record = book.find(task_id)
                if record is not None and record.state in (TaskState.OFFERED, TaskState.RUNNING):
                    planning.begun(task_id, robot)
        return False

    def _publish_left_out(self, now_ns: int) -> None:
        """Publish why a task is left out, once, and again when the reason's code changes."""
        if self._planning.number == self._published_number and now_ns < self._publish_ns:
            return
        self._published_number, self._publish_ns = self._planning.number, now_ns + TELL_NS
        reasons = self._lifecycle.reasons
        is_anybody_out = self._planning.anybody_out(now_ns)
        paused = {task for task, _ in self._lifecycle.backoff.pauses(now_ns)}
        for task_id, left in self._planning.left_out.items():
            record = self._book.find(task_id)
            if record is None or record.state is not TaskState.QUEUED:
                continue
            if task_id in paused or reasons.nobody_can(record) is not None:
                continue  # the published reason says more
            if is_anybody_out and reasons.able_but_out(record, now_ns):
                continue  # it may still be done
            if record.task.deadline_ns is None and now_ns - left.since_ns > to_ns(self._planning.policy.give_up_s):
                gave_up = plain("gave_up", f"nobody can do it: {left.reason}", because=left.reason.code)
                self._book.move(task_id, TaskState.FAILED, gave_up)
            elif not _is_alike(record.reason, left.reason):
                self._book.move(task_id, TaskState.QUEUED, left.reason)


def _is_alike(told: TaskReason | None, reason: PlanReason) -> bool:
    """Whether two reasons, and those within them, have the same codes; figures and names may differ."""
    if isinstance(told, NearestOut) and isinstance(reason, NearestOut):
        return told.because.code == reason.because.code
    return told is not None and told.code == reason.code
