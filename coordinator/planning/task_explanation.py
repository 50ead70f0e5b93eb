"""Explains the state of a task, and why a robot does not get it; predicts both for a task that is not submitted."""

from collections.abc import Callable, Iterator, Mapping, Sequence

import msgspec

from robrain.coordinator.planning.forecast import TaskTimes
from robrain.coordinator.planning.live_planner import Supposed
from robrain.coordinator.planning.planning import Planning
from robrain.coordinator.tasks.eligibility import NOBODY_THERE
from robrain.coordinator.tasks.task_lifecycle import TaskLifecycle
from robrain.coordinator.team.roster import Robot
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.errors import CallError
from robrain.protocol.messages.tasks.task_messages import (
    RobotVerdict,
    TaskDelay,
    TaskDryRun,
    TaskExplanation,
    TaskRecord,
)
from robrain.protocol.model.ranges import TEXT_MAX, cut
from robrain.protocol.model.tasks.task import MEMBER_PREFIX, Task, TaskState
from robrain.protocol.reasons import (
    NO_ROUND_TRIP,
    IsNext,
    NearestOut,
    PlanLeavesOut,
    RobotReason,
    TaskReason,
    plain,
    position_unknown,
    sentence_of,
)

DELAY_NS = to_ns(5.0)
"""Smaller delays of other tasks are not reported (chosen: estimates are no better)."""


class TaskExplainer:
    """Finds reasons.

    Args:
        lifecycle: of the tasks, with the book and the robots.
        planning: the plan's decision.

    """

    def __init__(self, lifecycle: TaskLifecycle, planning: Planning) -> None:
        self._book, self._roster, self._backoff = lifecycle.book, lifecycle.roster, lifecycle.backoff
        self._eligibility, self._planning, self._gate = lifecycle.eligibility, planning, lifecycle.gate

    def explain(self, record: TaskRecord, now_ns: int, answer: Callable[[TaskExplanation | CallError], None]) -> None:
        """Answer why a task stands as it does; for an open one with each robot's cost from now on.

        Args:
            record: of the task.
            now_ns: the time.
            answer: called once, for an open task when a plan with it is made.

        """
        is_queued = record.state is TaskState.QUEUED
        reason = self._reason(record, now_ns) if is_queued else record.reason
        found = TaskExplanation(
            record=self.estimated(record, now_ns),
            now=cut(self._now(record, reason), TEXT_MAX),
            reason=reason,
            robots=[RobotVerdict(robot=name, chosen=True) for name in sorted(_whose(record))],
            changes=self._book.journal.history(record.task.id),
        )
        if record.state.ended or record.own:
            answer(found)
            return

        def on_plan(one: Supposed) -> None:
            judged = self._judge(record, now_ns, () if one.planned is None else one.planned.bids)
            remedies = one.remedies if is_queued else []
            answer(msgspec.structs.replace(found, robots=judged, decided_ns=now_ns, remedies=remedies))

        unbegun = msgspec.structs.replace(record, state=TaskState.QUEUED, robot="")
        try:
            self._planning.suppose(unbegun, now_ns, on_plan)
        except CallError as error:
            answer(error)

    def estimated(self, record: TaskRecord, now_ns: int) -> TaskRecord:
        """The record of an open task with its estimate."""
        if record.state.ended:
            return record
        return msgspec.structs.replace(record, estimate=self._planning.forecast.of(record.task.id, now_ns))

    def _judge(self, record: TaskRecord, now_ns: int, bids: Sequence[RobotVerdict]) -> list[RobotVerdict]:
        """Each member's verdict on an open task: why it is excluded, or else the cost of the task by a plan of now."""
        whose = _whose(record)
        corrected = {bid.robot: self._planning.forecast.corrected(bid) for bid in bids}
        others = {one.robot: one for one in self._gate.verdicts(record, now_ns)}
        judged = [one for name, one in others.items() if name not in self._roster.robots]
        for name, robot in sorted(self._roster.robots.items()):
            pose = None if robot.state is None else robot.state.pose
            reason = None if name in whose else self._ruled_out(record, robot, now_ns)
            if reason is None and pose is None:
                reason = position_unknown()
            one = others.get(name, corrected.get(name)) if reason is None else None
            one = one or RobotVerdict.judged(name, reason)
            away_m = None if pose is None else round(pose.distance_m(record.task.place), 2)
            judged.append(msgspec.structs.replace(one, distance_m=away_m))
        if not whose:
            return judged
        judged += [RobotVerdict(robot=name) for name in sorted(whose - {one.robot for one in judged})]
        return [
            msgspec.structs.replace(one, chosen=True, refusal="", reason=None)
            if one.robot in whose
            else msgspec.structs.replace(one, chosen=False)
            for one in judged
        ]

    def dry_run(self, task: Task, by: str, now_ns: int, answer: Callable[[TaskDryRun | CallError], None]) -> None:
        """Answer the result of a task if it were submitted now; nothing is written or offered.

        Args:
            task: an admitted one, with stamps in place of times that count from now; its id is not in the book.
            by: name of the client that would submit it.
            now_ns: the time.
            answer: called once, when the plan with this task is made.

        """
        record = TaskRecord(task=task, state=TaskState.QUEUED, by=by, submitted_ns=now_ns)
        reason = self._eligibility.new_task_state(record, now_ns)
        waiting = [one for one in self._book.open if not one.own and one.state is TaskState.QUEUED]
        before = self._planning.forecast.times

        def on_plan(supposed: Supposed) -> None:
            plan, forecast = supposed.planned, self._planning.forecast
            after = forecast.times_of(plan, [*self._book.open, record], now_ns)
            times = after.get(task.id)
            result = TaskDryRun(
                task=task,
                waits=cut(sentence_of(reason), TEXT_MAX),
                reason=reason or (None if plan is None else plan.left_out.get(task.id)),
                robots=self._judge(record, now_ns, () if plan is None else plan.bids),
                ahead=sum(one.task.priority >= task.priority for one in waiting),
                estimate=None if times is None else forecast.estimate(task.id, times, now_ns),
                delays=list(self._delays(before, after)) if plan is not None else [],
                remedies=supposed.remedies,
                blocks=[cut(name) for name in supposed.blocks],
            )
            answer(result)

        try:
            self._planning.suppose(record, now_ns, on_plan)
        except CallError as error:
            answer(error)

    def _delays(self, before: Mapping[str, TaskTimes], after: Mapping[str, TaskTimes]) -> Iterator[TaskDelay]:
        """The tasks that would end later, or that no plan would include any more."""
        for task_id, times in before.items():
            record, then = self._book.find(task_id), after.get(task_id)
            if record is None or record.state.ended:
                continue
            if then is None:
                yield TaskDelay(task=task_id)
                continue
            later_ns, deadline_ns = then.end_ns - times.end_ns, record.task.deadline_ns
            misses_deadline = deadline_ns is not None and times.end_ns <= deadline_ns < then.end_ns
            if misses_deadline or later_ns > DELAY_NS:
                yield TaskDelay(task=task_id, later_s=round(to_seconds(later_ns), 1), misses_deadline=misses_deadline)

    def able_but_out(self, record: TaskRecord, now_ns: int) -> bool:
        """Whether a robot could do the task but is excluded from everything now."""
        return any(
            robot.has_token
            and self._eligibility.unfit_reason(record, robot) is None
            and self._planning.exclusion(robot, now_ns) is not None
            for robot in self._roster.robots.values()
        )

    def _ruled_out(self, record: TaskRecord, robot: Robot, now_ns: int) -> RobotReason | None:
        """Why a robot cannot get a task, whether or not it does another one now."""
        if (unfit := self._eligibility.unfit_reason(record, robot)) is not None:
            return unfit
        if (out := self._planning.exclusion(robot, now_ns)) is not None:
            return out
        return self._backoff.pause_reason(record.task.id, robot.name, now_ns)

    def _reason(self, record: TaskRecord, now_ns: int) -> TaskReason:
        """Why a queued task is not at a robot now."""
        reason = self._eligibility.wait_reason(record, now_ns) or self._eligibility.nobody_can(record, now_ns)
        planning, task_id = self._planning, record.task.id
        if reason is None and (planning.waits_for_charge(task_id) or not self.able_but_out(record, now_ns)):
            reason = planning.queued_reason(task_id, now_ns)
        return reason or (
            plain("waits_for_robot", "it waits for a robot to be free") if self._roster.up(now_ns) else NOBODY_THERE
        )

    def _now(self, record: TaskRecord, reason: TaskReason | None) -> str:
        """The same in sentences, for people."""
        if record.robot and self._book.next_of(record.robot) == record:
            return f"Next at {record.robot}{f', after {reason.after}' if isinstance(reason, IsNext) else ''}."
        state = record.state.replace("_", " ").capitalize()
        if record.state is not TaskState.QUEUED:
            robot = f" {'by' if record.state is TaskState.DONE else 'at'} {record.robot}" if record.robot else ""
            known = self._roster.robots.get(record.robot)
            words = known.state.wait_words if known is not None and known.state is not None else ""
            waits = f" {record.robot} {words}." if words and record.state is TaskState.RUNNING else ""
            return f"{state}{robot}.{waits} {self._as_sentence(record.why)}".rstrip()
        nearest = reason.because if isinstance(reason, PlanLeavesOut) else None
        if isinstance(nearest, NearestOut) and nearest.because.code == NO_ROUND_TRIP:
            place = record.task.place
            words = f"No robot can reach ({place.x_m:g}, {place.y_m:g}) and then a charger. {nearest.robot} is nearest."
        else:
            words = self._as_sentence(sentence_of(reason))
        is_same = record.reason in (reason, nearest)
        return f"{state}. {words}{'' if is_same else f' {self._as_sentence(record.why)}'}".rstrip()

    def _as_sentence(self, text: str) -> str:
        """A text with a capital letter, unless it begins with a name, and a full stop."""
        first = text.partition(" ")[0].rstrip(",;:")
        is_named = first in self._roster.robots or self._book.find(first) is not None
        return f"{text if is_named else text[:1].upper() + text[1:]}{'' if text.endswith('.') else '.'}" if text else ""


def _whose(record: TaskRecord) -> set[str]:
    """The robots, or the mote, that have the task, or had it at its end."""
    team = record.result.get("robots")
    return {record.robot.removeprefix(MEMBER_PREFIX)} if record.robot else set(team if isinstance(team, list) else ())
