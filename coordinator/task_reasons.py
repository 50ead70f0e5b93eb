"""Why a task stands as it does, and why a robot is not given it: in words, for people, and to decide by."""

from robrain.coordinator.admission import needed_plugins, why_nobody_can
from robrain.coordinator.capabilities import Capabilities
from robrain.coordinator.dispatch import verdicts
from robrain.coordinator.roster import Robot, Roster
from robrain.coordinator.shunning import Shunning
from robrain.coordinator.task_book import TaskBook
from robrain.protocol.model.task import TaskState
from robrain.protocol.wire.clock import to_seconds
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
            robots = [self._roster.robots[name] for name in sorted(self._roster.robots)]
            judged = verdicts(record, robots, lambda one, robot: self.not_for(one, robot, now_ns))
            decided_ns = now_ns
        return TaskWhy(
            record=record,
            now=self._now(record, now_ns),
            robots=judged,
            decided_ns=decided_ns,
            changes=self._book.journal.history(record.task.id),
        )

    def nobody_can(self, record: TaskRecord) -> str:
        """Why no robot of the team has what the task takes; empty if one has, or may have."""
        return why_nobody_can(record.task, self._capabilities.plugins)

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

    def waits(self, record: TaskRecord, now_ns: int) -> str:
        """Why a task cannot be offered to anybody yet; empty if it can."""
        task = record.task
        if record.state is not TaskState.QUEUED:
            return f"it is {record.state}"
        if record.own:
            return "it is one of the coordinator itself"
        if now_ns < task.earliest_ns:
            return f"it may begin in {to_seconds(task.earliest_ns - now_ns):.1f} s"
        for name in task.after:
            other = self._book.find(name)
            if other is None:
                return f"{name}, which it waits for, is not known yet"
            if other.state is not TaskState.DONE:
                return f"{name}, which it waits for, is {other.state}"
        return ""

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
        if record.state is not TaskState.QUEUED:
            return f"it is {record.state.replace('_', ' ')}{f' at {record.robot}' if record.robot else ''}{told}"
        why = self.waits(record, now_ns) or self.nobody_can(record)
        if not why:
            why = "it waits for a robot to be free" if self._roster.up(now_ns) else "no robot is there"
        return f"it is queued: {why}{f' ({record.why})' if record.why not in ('', why) else ''}"
