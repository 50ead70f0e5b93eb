"""Explains the state of a task, and why a robot does not get it."""

from collections.abc import Callable, Sequence

import msgspec

from robrain.coordinator.planning.planning import Planning
from robrain.coordinator.tasks.admission import capability_refusal, needed_plugins
from robrain.coordinator.tasks.backoff import TaskBackoff
from robrain.coordinator.tasks.offers import verdicts
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.team.capabilities import Capabilities
from robrain.coordinator.team.roster import Robot, Roster
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.tasks.task_messages import RobotVerdict, TaskRecord, TaskWhy
from robrain.protocol.model.ranges import TEXT_MAX, cut
from robrain.protocol.model.tasks.task import MEMBER_PREFIX, TaskState
from robrain.protocol.reasons import (
    IsNext,
    PlainReason,
    PlanLeavesOut,
    RobotOut,
    RobotReason,
    TaskReason,
    halted,
    holder_out,
    lacks_plugins,
    plain,
    told,
)

KEPT_VERDICTS = 1000
TOLD_MAX = 8
"""Most robots that a reason names."""
NOBODY_THERE = plain("nobody_there", "no robot is there")


class TaskExplanation:
    """Finds reasons.

    Args:
        book: of the tasks.
        roster: the robots of the team.
        capabilities: plugins and kinds of task of the robots.
        backoff: tasks that robots refused or failed at, and until when they are not offered again.

    """

    def __init__(self, book: TaskBook, roster: Roster, capabilities: Capabilities, backoff: TaskBackoff) -> None:
        self._book = book
        self._roster = roster
        self._capabilities = capabilities
        self._backoff = backoff
        self._verdicts: dict[str, tuple[int, list[RobotVerdict]]] = {}
        self.planning: Planning | None = None
        """Set if tasks are planned."""
        self.others: Callable[[TaskRecord, int], list[RobotVerdict]] = lambda _record, _now_ns: []
        """Verdicts on members that are no robots."""
        self.held_back: Callable[[], TaskReason | None] = lambda: None
        """Why no task is offered at all; None if tasks are."""
        self.held_by: Callable[[str, int], str] = lambda _task_id, _now_ns: ""
        """The robot that may be at a queued task, though no coordinator gave it; empty if there is none."""

    def note(self, task_id: str, verdicts: list[RobotVerdict], now_ns: int) -> None:
        """Keep the verdicts with which a task was assigned."""
        self._verdicts.pop(task_id, None)
        self._verdicts[task_id] = (now_ns, verdicts)
        if len(self._verdicts) > KEPT_VERDICTS:
            del self._verdicts[next(iter(self._verdicts))]

    def explain(self, record: TaskRecord, now_ns: int) -> TaskWhy:
        """Explain the state of a task; for a queued one, with each robot's present verdict."""
        decided_ns, judged = self._verdicts.get(record.task.id, (0, []))
        if record.state is TaskState.QUEUED:
            judged, decided_ns = self.judge(record, now_ns), now_ns
        else:
            judged = _as_it_went(record, judged)
        reason = self._reason(record, now_ns) if record.state is TaskState.QUEUED else record.reason
        return TaskWhy(
            record=record,
            now=cut(self._now(record, reason), TEXT_MAX),
            reason=reason,
            robots=judged,
            decided_ns=decided_ns,
            changes=self._book.journal.history(record.task.id),
        )

    def judge(self, record: TaskRecord, now_ns: int, chosen: Sequence[str] = ()) -> list[RobotVerdict]:
        """Each robot's verdict on a task now: why it is excluded, or else what the task would cost it by the plan.

        Args:
            record: of the task.
            now_ns: the time.
            chosen: the robots that get it.

        """
        robots = [self._roster.robots[name] for name in sorted(self._roster.robots)]
        others = self.others(record, now_ns)
        if self.planning is None or not self.planning.is_on:
            first = next(iter(chosen), "")
            return [*others, *verdicts(record, robots, lambda one, robot: self.not_for(one, robot, now_ns), first)]
        judged = verdicts(record, robots, lambda one, robot: self._ruled_out(one, robot, now_ns))
        found = self.planning.decision(record.task.id)
        bids = {} if found is None else {bid.robot: bid for bid in found[1].bids}
        stands = others
        for one in judged:
            bid = bids.get(one.robot)
            if bid is not None and one.reason is None:
                one = msgspec.structs.replace(
                    one,
                    why_not=bid.why_not,
                    reason=bid.reason,
                    energy_j=bid.energy_j,
                    time_s=bid.time_s,
                    chosen=bid.chosen,
                )
            if chosen:
                one = msgspec.structs.replace(one, chosen=one.robot in chosen)
            stands.append(one)
        return stands

    def able_but_out(self, record: TaskRecord, now_ns: int) -> bool:
        """Whether a robot could do the task but is excluded from everything now."""
        if self.planning is None:
            return False
        return any(
            robot.has_token and not self._lacks(record, robot) and self.planning.exclusion(robot, now_ns) is not None
            for robot in self._roster.robots.values()
        )

    def _ruled_out(self, record: TaskRecord, robot: Robot, now_ns: int) -> RobotReason | None:
        """As `not_for`, except that a robot that does another task is not excluded: it may do this one next."""
        if missing := self._lacks(record, robot):
            return lacks_plugins(missing)
        if self.planning is not None and (out := self.planning.exclusion(robot, now_ns)) is not None:
            return out
        return self._backoff.why(record.task.id, robot.name, now_ns)

    def nobody_can(self, record: TaskRecord) -> TaskReason | None:
        """Why no robot of the team can do the task; None if one can, or may."""
        return capability_refusal(record.task, self._capabilities.plugins)

    def hopeless(self, record: TaskRecord, now_ns: int) -> PlainReason | None:
        """The answers of all present and able robots, if none of them will be asked again; else None.

        A task with a deadline is kept until then.
        """
        if record.task.deadline_ns is not None:
            return None
        outs = []
        for robot in self._roster.up(now_ns):
            if self._lacks(record, robot):
                continue
            reason = self._backoff.last_word(record.task.id, robot.name)
            if reason is None:
                return None
            outs.append(RobotOut(robot.name, reason))
        if not outs:
            return None
        listed, more = outs[:TOLD_MAX], len(outs[TOLD_MAX:])
        text = f"nobody does it: {'; '.join(map(str, listed))}{f' and {more} more' if more else ''}"
        return plain("nobody_does", text, robots=tuple(one.robot for one in listed), more=more)

    def waits(self, record: TaskRecord, now_ns: int, way_s: float = 0.0) -> TaskReason | None:
        """Why a task cannot be offered to any robot yet; None if it can.

        Args:
            record: of the task.
            now_ns: the time.
            way_s: travel time of its robot, which may set out before the task's earliest time.

        """
        task = record.task
        if record.state is not TaskState.QUEUED:
            return plain("is_state", f"it is {record.state}", state=record.state)
        if record.own:
            return plain("is_own", "it is one of the coordinator itself")
        if (held_back := self.held_back()) is not None:
            return held_back
        if holder := self.held_by(task.id, now_ns):
            return holder_out(holder)
        if now_ns + to_ns(way_s) < task.earliest_ns:
            in_s = to_seconds(task.earliest_ns - now_ns)
            return plain("not_before", f"it may begin in {in_s:.1f} s", in_s=in_s)
        for name in task.after:
            other = self._book.find(name)
            if other is None:
                return plain("after_unknown", f"{name}, which it waits for, is not known yet", task=name)
            if other.state is not TaskState.DONE:
                text = f"{name}, which it waits for, is {other.state}"
                return plain("after_open", text, task=name, state=other.state)
        return None

    def new_task_state(self, record: TaskRecord, now_ns: int) -> TaskReason | None:
        """What a task that is not in the book would wait for before any robot could begin it; None if for nothing."""
        reason = self.waits(record, now_ns) or self.nobody_can(record)
        return reason or (None if self._roster.up(now_ns) else NOBODY_THERE)

    def avoid(self, task_id: str, member: str, reason: RobotReason, now_ns: int) -> None:
        """Exclude a member that did a task from it for a while."""
        self._backoff.note(task_id, member, reason, now_ns)

    def avoided(self, task_id: str, member: str, now_ns: int) -> RobotReason | None:
        """Why a member must not be asked for a task now; None if it may."""
        return self._backoff.why(task_id, member, now_ns)

    def not_for(self, record: TaskRecord, robot: Robot, now_ns: int) -> RobotReason | None:
        """Why a task is not offered to a robot; None if it may be."""
        if missing := self._lacks(record, robot):
            return lacks_plugins(missing)
        if (out := robot.down_reason(now_ns)) is not None:
            return out
        if robot.state is not None and robot.state.halted:
            return halted()
        if other := self._book.of_robot(robot.name):
            return plain("at_task", f"is at {other.task.id}", task=other.task.id)
        return self._backoff.why(record.task.id, robot.name, now_ns)

    def _lacks(self, record: TaskRecord, robot: Robot) -> tuple[str, ...]:
        plugins = self._capabilities.plugins.get(robot.name)
        return tuple(name for name in needed_plugins(record.task) if plugins is not None and name not in plugins)

    def _reason(self, record: TaskRecord, now_ns: int) -> TaskReason:
        """Why a queued task is not at a robot now."""
        reason = self.waits(record, now_ns) or self.nobody_can(record)
        planning, task_id = self.planning, record.task.id
        is_planned = planning is not None and bool(planning.waits_for_charge(task_id))
        if reason is None and planning is not None and (is_planned or not self.able_but_out(record, now_ns)):
            reason = planning.standing(task_id, now_ns)
        return reason or (
            plain("waits_for_robot", "it waits for a robot to be free") if self._roster.up(now_ns) else NOBODY_THERE
        )

    def _now(self, record: TaskRecord, reason: TaskReason | None) -> str:
        """The same in one sentence, for people."""
        state = record.state.replace("_", " ")
        if record.robot and self._book.next_of(record.robot) == record:
            after = f" after {reason.after}" if isinstance(reason, IsNext) else ""
            return f"it is next at {record.robot}{after}"
        if record.state is not TaskState.QUEUED:
            return f"it is {state}{record.robot and f' at {record.robot}'}{record.why and f': {record.why}'}"
        is_told = record.reason in (reason, reason.because if isinstance(reason, PlanLeavesOut) else None)
        also = f" ({record.why})" if record.why and not is_told else ""
        return f"it is queued: {told(reason)}{also}"


def _as_it_went(record: TaskRecord, judged: list[RobotVerdict]) -> list[RobotVerdict]:
    """The verdicts with the robot marked as chosen that has the task, or had it at its end.

    That may be another than the last choice: a lost robot may have finished a task before it was reassigned.
    """
    team = record.result.get("robots")
    whose = {record.robot.removeprefix(MEMBER_PREFIX)} if record.robot else set(team if isinstance(team, list) else ())
    if not whose:
        return judged
    known = {one.robot for one in judged}
    all_judged = [*judged, *(RobotVerdict(robot=name) for name in sorted(whose - known))]
    return [
        msgspec.structs.replace(one, chosen=True, why_not="", reason=None)
        if one.robot in whose
        else msgspec.structs.replace(one, chosen=False)
        for one in all_judged
    ]
