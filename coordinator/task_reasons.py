"""Why a task stands as it does, and why a robot is not given it: in words, for people, and to decide by."""

from collections.abc import Callable, Sequence

import msgspec

from robrain.coordinator.admission import needed_plugins, why_nobody_can
from robrain.coordinator.capabilities import Capabilities
from robrain.coordinator.dispatch import verdicts
from robrain.coordinator.motes import MEMBER_PREFIX
from robrain.coordinator.planning.planning import Planning
from robrain.coordinator.roster import Robot, Roster
from robrain.coordinator.shunning import Shunning
from robrain.coordinator.task_book import TaskBook
from robrain.protocol.model.ranges import TEXT_MAX, cut
from robrain.protocol.model.task import TaskState
from robrain.protocol.wire.clock import to_ns, to_seconds
from robrain.protocol.wire.task_messages import RobotVerdict, TaskRecord, TaskWhy

KEPT_VERDICTS = 1000


class TaskReasons:
    """Finds reasons.

    Args:
        book: of the tasks.
        roster: the robots that there are.
        capabilities: what they can do.
        shunning: what they refused or failed at.

    """

    def __init__(self, book: TaskBook, roster: Roster, capabilities: Capabilities, shunning: Shunning) -> None:
        self._book = book
        self._roster = roster
        self._capabilities = capabilities
        self._shunning = shunning
        self._verdicts: dict[str, tuple[int, list[RobotVerdict]]] = {}
        self.planning: Planning | None = None
        """Who plans, if anybody does."""
        self.others: Callable[[TaskRecord, int], list[RobotVerdict]] = lambda _record, _now_ns: []
        """How members that are no robots stand to a task now."""

    def note(self, task_id: str, verdicts: list[RobotVerdict], now_ns: int) -> None:
        """A task was given to somebody, and robots were judged for it."""
        self._verdicts.pop(task_id, None)
        self._verdicts[task_id] = (now_ns, verdicts)
        if len(self._verdicts) > KEPT_VERDICTS:
            del self._verdicts[next(iter(self._verdicts))]

    def explain(self, record: TaskRecord, now_ns: int) -> TaskWhy:
        """Why a task stands as it does; of a queued one, how each robot stands to it now."""
        decided_ns, judged = self._verdicts.get(record.task.id, (0, []))
        if record.state is TaskState.QUEUED:
            judged, decided_ns = self.judge(record, now_ns), now_ns
        else:
            judged = _as_it_went(record, judged)
        return TaskWhy(
            record=record,
            now=cut(self._now(record, now_ns), TEXT_MAX),
            robots=judged,
            decided_ns=decided_ns,
            changes=self._book.journal.history(record.task.id),
        )

    def judge(self, record: TaskRecord, now_ns: int, chosen: Sequence[str] = ()) -> list[RobotVerdict]:
        """How each robot stands to a task now: what rules it out, or else what the plan found that it would take it.

        Args:
            record: the task.
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
        told = others
        for one in judged:
            bid = bids.get(one.robot)
            if bid is not None and not one.why_not:
                one = msgspec.structs.replace(
                    one, why_not=bid.why_not, energy_j=bid.energy_j, time_s=bid.time_s, chosen=bid.chosen
                )
            if chosen:
                one = msgspec.structs.replace(one, chosen=one.robot in chosen)
            told.append(one)
        return told

    def able_but_out(self, record: TaskRecord, now_ns: int) -> bool:
        """Whether a robot could do the task, were it not for what keeps it from everything now."""
        if self.planning is None:
            return False
        return any(
            robot.has_token and not self._lacks(record, robot) and self.planning.why_out(robot, now_ns)
            for robot in self._roster.robots.values()
        )

    def _ruled_out(self, record: TaskRecord, robot: Robot, now_ns: int) -> str:
        """As `not_for`; but a robot that is at another task may well be the one that does this one next."""
        if missing := self._lacks(record, robot):
            return f"has no {' and no '.join(missing)}"
        if self.planning is not None and (why := self.planning.why_out(robot, now_ns)):
            return why
        return self._shunning.why(record.task.id, robot.name, now_ns)

    def nobody_can(self, record: TaskRecord) -> str:
        """Why no robot of the team has what the task takes; empty if one has, or may have."""
        return cut(why_nobody_can(record.task, self._capabilities.plugins))

    def hopeless(self, record: TaskRecord, now_ns: int) -> str:
        """What each robot that is there and has what the task takes has said, if none of them is to be asked again.

        A task with a deadline is hoped for until then.
        """
        if record.task.deadline_ns is not None:
            return ""
        words = []
        for robot in self._roster.up(now_ns):
            if self._lacks(record, robot):
                continue
            word = self._shunning.last_word(record.task.id, robot.name)
            if not word:
                return ""
            words.append(f"{robot.name} {word}")
        return "; ".join(words)

    def waits(self, record: TaskRecord, now_ns: int, way_s: float = 0.0) -> str:
        """Why a task cannot be offered to anybody yet; empty if it can.

        Args:
            record: the task.
            now_ns: the time.
            way_s: how long its robot is on its way to it, so that it may set out before the task may begin.

        """
        task = record.task
        if record.state is not TaskState.QUEUED:
            return f"it is {record.state}"
        if record.own:
            return "it is one of the coordinator itself"
        if now_ns + to_ns(way_s) < task.earliest_ns:
            return f"it may begin in {to_seconds(task.earliest_ns - now_ns):.1f} s"
        for name in task.after:
            other = self._book.find(name)
            if other is None:
                return f"{name}, which it waits for, is not known yet"
            if other.state is not TaskState.DONE:
                return f"{name}, which it waits for, is {other.state}"
        return ""

    def shun(self, task_id: str, member: str, why: str, now_ns: int) -> None:
        """Somebody who was at a task is not to be asked for it for a while."""
        self._shunning.note(task_id, member, why, now_ns)

    def shunned(self, task_id: str, member: str, now_ns: int) -> str:
        """Why somebody is not to be asked for a task now; empty if that may be."""
        return self._shunning.why(task_id, member, now_ns)

    def not_for(self, record: TaskRecord, robot: Robot, now_ns: int) -> str:
        """Why a task is not offered to a robot; empty if it can be."""
        if missing := self._lacks(record, robot):
            return f"has no {' and no '.join(missing)}"
        if not robot.is_up(now_ns):
            return robot.why_not_up(now_ns)
        if robot.state is not None and robot.state.halted:
            return "is halted"
        if other := self._book.of_robot(robot.name):
            return f"is at {other.task.id}"
        return self._shunning.why(record.task.id, robot.name, now_ns)

    def _lacks(self, record: TaskRecord, robot: Robot) -> list[str]:
        plugins = self._capabilities.plugins.get(robot.name)
        return [name for name in needed_plugins(record.task) if plugins is not None and name not in plugins]

    def _now(self, record: TaskRecord, now_ns: int) -> str:
        told = f": {record.why}" if record.why else ""
        if record.robot and self._book.next_of(record.robot) == record:
            return f"it is next at {record.robot}{told.replace(': it is next,', '', 1)}"
        if record.state is not TaskState.QUEUED:
            return f"it is {record.state.replace('_', ' ')}{f' at {record.robot}' if record.robot else ''}{told}"
        why = self.waits(record, now_ns) or self.nobody_can(record)
        planning, task_id = self.planning, record.task.id
        is_planned = planning is not None and bool(planning.waits_for_charge(task_id))
        if not why and planning is not None and (is_planned or not self.able_but_out(record, now_ns)):
            why = planning.words(task_id, now_ns)
        if not why:
            why = "it waits for a robot to be free" if self._roster.up(now_ns) else "no robot is there"
        return f"it is queued: {why}{f' ({record.why})' if record.why not in ('', why) else ''}"


def _as_it_went(record: TaskRecord, judged: list[RobotVerdict]) -> list[RobotVerdict]:
    """The verdicts with those chosen that have it, or had it when it ended.

    That may be others than were chosen last: a robot that was lost had done it before it was given to another.
    """
    team = record.result.get("robots")
    whose = {record.robot.removeprefix(MEMBER_PREFIX)} if record.robot else set(team if isinstance(team, list) else ())
    if not whose:
        return judged
    known = {one.robot for one in judged}
    told = [*judged, *(RobotVerdict(robot=name) for name in sorted(whose - known))]
    return [
        msgspec.structs.replace(one, chosen=one.robot in whose, why_not="" if one.robot in whose else one.why_not)
        for one in told
    ]
