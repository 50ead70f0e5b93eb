"""Executes the plan: offers due tasks, publishes why tasks are unplanned, and fails those unplanned for too long."""

from collections.abc import Callable, Sequence

from robrain.coordinator.planning.coalition import Coalitions
from robrain.coordinator.planning.planning import Planning
from robrain.coordinator.planning.snapshot import urgency
from robrain.coordinator.planning.task_explanation import TaskExplainer
from robrain.coordinator.tasks.task_lifecycle import TaskLifecycle
from robrain.coordinator.team.roster import Robot
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.reasons import (
    BelowReserve,
    LacksEnergy,
    NearestOut,
    PlanReason,
    RobotReason,
    Shut,
    TaskReason,
    needed_for,
    plain,
)

OFFERS_MAX = 16
"""Offers per step: each is journalled first, and the team must not wait for that."""
CHECK_NS = to_ns(5.0)
"""Interval between checks of left-out tasks while the plan stays the same."""


class PlanExecutor:
    """Offers tasks by the plan, or without plans to the nearest idle robots.

    Args:
        planning: makes the plans.
        lifecycle: of the tasks, with the book and the robots.
        explanation: finds robots that are able to do a task.
        coalitions: executes tasks for several robots.

    """

    def __init__(
        self, planning: Planning, lifecycle: TaskLifecycle, explanation: TaskExplainer, coalitions: Coalitions
    ) -> None:
        self._planning, self._lifecycle, self._book = planning, lifecycle, lifecycle.book
        self._explanation, self._coalitions = explanation, coalitions
        self._published_number = 0
        self._publish_ns = 0

    def step(self, robots: Sequence[Robot], now_ns: int, *, is_halted: bool) -> bool:
        """Offer tasks to robots that can do them now.

        Args:
            robots: those that may act and have no task.
            now_ns: the time.
            is_halted: whether the team is halted; then nothing is offered.

        Returns:
            Whether more is to be offered, at the next step.

        """
        ready = self._lifecycle.publish_unfit(now_ns)
        if not self._planning.is_on:
            self._dispatch(ready, robots, now_ns)
            return False
        if is_halted:
            return False
        has_more = self._follow_plan(now_ns)
        self._coalitions.step(now_ns)
        return has_more

    def _dispatch(self, ready: Sequence[TaskRecord], idle: Sequence[Robot], now_ns: int) -> None:
        """Offer ready tasks to the nearest robots."""
        eligibility = self._lifecycle.eligibility

        def refusal(record: TaskRecord, robot: Robot) -> RobotReason | None:
            return eligibility.refusal(record, robot, now_ns)

        with self._lifecycle.as_far_as_written(now_ns):
            for task_id, robot in dispatch(ready, idle, refusal):
                self._lifecycle.offer(task_id, robot, now_ns)

    def _follow_plan(self, now_ns: int) -> bool:
        """Offer due tasks; a robot that explores gives that up. Returns whether more is due."""
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
                lifecycle.offer(task_id, robot, now_ns, after=after)
                record = book.find(task_id)
                if record is not None and record.state in (TaskState.OFFERED, TaskState.RUNNING):
                    planning.begun(task_id, robot)
        return False

    def _publish_left_out(self, now_ns: int) -> None:
        """Publish why a task is unplanned, once, and again when the reason's code changes."""
        if self._planning.number == self._published_number and now_ns < self._publish_ns:
            return
        self._published_number, self._publish_ns = self._planning.number, now_ns + CHECK_NS
        eligibility, explanation = self._lifecycle.eligibility, self._explanation
        is_anybody_out = self._planning.anybody_out(now_ns)
        paused = {task for task, _ in self._lifecycle.backoff.pauses(now_ns)}
        charging = {charge.robot for charge in self._planning.charges}
        for task_id, left in self._planning.left_out.items():
            record = self._book.find(task_id)
            if record is None or record.state is not TaskState.QUEUED or eligibility.unplannable(record) is not None:
                continue
            if task_id in paused or eligibility.nobody_can(record, now_ns) is not None:
                continue  # the published reason has more details
            if is_anybody_out and explanation.able_but_out(record, now_ns):
                continue  # it may still be done
            may_wait = record.task.deadline_ns is not None or isinstance(left.reason, Shut)
            if isinstance(left.reason, NearestOut) and isinstance(left.reason.because, BelowReserve | LacksEnergy):
                may_wait |= left.reason.robot in charging
            if not may_wait and now_ns - left.since_ns > to_ns(self._planning.policy.give_up_s):
                gave_up = plain(
                    "gave_up",
                    f"no plan had it for {self._planning.policy.give_up_s:.0f} s: {left.reason}",
                    because=left.reason.code,
                )
                self._book.move(task_id, TaskState.FAILED, gave_up)
            elif not _is_alike(record.reason, left.reason):
                self._book.move(task_id, TaskState.QUEUED, left.reason)


def _is_alike(published: TaskReason | None, reason: PlanReason) -> bool:
    """Whether two reasons, and those within them, have the same codes; figures and names may differ."""
    if isinstance(published, NearestOut) and isinstance(reason, NearestOut):
        return published.because.code == reason.because.code
    return published is not None and published.code == reason.code


Refusal = Callable[[TaskRecord, Robot], RobotReason | None]
"""Why a task must not go to a robot now; None if it may."""


def dispatch(ready: Sequence[TaskRecord], idle: Sequence[Robot], refusal: Refusal) -> list[tuple[str, str]]:
    """Assign each ready task to the nearest robot that is still idle.

    Args:
        ready: queued tasks that can begin.
        idle: robots that can take one task each.
        refusal: why a robot is excluded from a task.

    Returns:
        Task and robot of each offer, the most urgent first.

    """
    free = {robot.name: robot for robot in idle}
    offers = []
    for record in sorted(ready, key=urgency):
        if not free:
            break
        able = [
            (pose.distance_m(record.task.place), name)
            for name, robot in free.items()
            if robot.state is not None and (pose := robot.state.pose) is not None and refusal(record, robot) is None
        ]
        if able:
            chosen = min(able)[1]
            del free[chosen]
            offers.append((record.task.id, chosen))
    return offers
