"""Which tasks may be offered now, and to which robots; which pauses robots have after refusals.

A robot that refused a task or failed at it is asked again later. An unreachable robot also gets a pause. When a link
recovers, its token and states arrive before its queryables. Without a pause the next task would follow each unanswered
offer at once.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple, Protocol, TypeVar

from robrain.coordinator.tasks.admission import capability_refusal, needed_plugins
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.team.capabilities import Capabilities
from robrain.coordinator.team.roster import Robot, Roster
from robrain.coordinator.team.team_map import TeamMap
from robrain.protocol.backoff import backoff_s
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.robots.robot_messages import BatteryState
from robrain.protocol.messages.tasks.consensus_messages import TeamBallot
from robrain.protocol.messages.tasks.task_messages import RobotVerdict, TaskRecord
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import (
    DoneJustNow,
    DoorShut,
    Gone,
    NeedsEnergy,
    Occupied,
    OfferRefusal,
    OutOfReach,
    PlainReason,
    PositionLost,
    ProcessPaused,
    Refused,
    RobotHalted,
    RobotOut,
    RobotReason,
    SameRobot,
    TaskReason,
    ZoneShut,
    halted,
    holder_out,
    lacks_plugins,
    plain,
    shut,
)

FIRST_PAUSE_S = 2.0
LONGEST_PAUSE_S = 60.0
LONGEST_AFTER = 6
"""Longest pause. Each refusal doubles the pause up to this (chosen). Maps grow and batteries charge, but a task that is
impossible must not be offered all the time. Six refusals lead to it."""
REFUSALS_MAX = 6
"""Refusals after which a robot's answer to a task is final (chosen); with these pauses, after a minute."""
PASSING = (DoneJustNow, DoorShut, Occupied, PositionLost, RobotHalted, ProcessPaused, ZoneShut)
"""Refusals for the present. The robot charges, is lost or halted, its process was paused, or a zone is shut."""
CHARGED_SOC = 0.9
"""State of charge from which a robot's want of energy is no passing one (chosen: below where charging ends)."""
KEPT = 4096

FIRST_ROBOT_PAUSE_S = 0.5
LONGEST_ROBOT_PAUSE_S = 8.0
"""Longest pause of a robot; each is twice the previous one (chosen)."""
REFUSALS_FREE = 3
"""Consecutive refusals of frontiers without a pause (chosen); the next frontier may be reachable."""
REPORTED_MAX = 8
"""Most robots that a reason names."""
PAUSED = "paused"
"""Kind of the reason of a paused task."""
NOBODY_THERE = plain("nobody_there", "no robot is there")


class _Pause(NamedTuple):
    until_ns: int
    times: int
    """Number of pauses in a row."""
    reason: RobotReason
    final_times: int = 0
    """Refusals that count towards the robot's final answer."""


K = TypeVar("K")


def _reason(pauses: Mapping[K, _Pause], key: K, now_ns: int) -> RobotReason | None:
    pause = pauses.get(key)
    return pause.reason if pause is not None and now_ns < pause.until_ns else None


class TaskPauses:
    """Remembers refusals and failures for each task and robot; drops the oldest beyond a limit."""

    def __init__(self) -> None:
        self._avoided: dict[tuple[str, str], _Pause] = {}
        self.robots = RobotPauses()
        """Robots that are offered nothing for a while, or none of the coordinator's own tasks."""

    def record(
        self, task_id: str, robot: str, reason: RobotReason, now_ns: int, battery: BatteryState | None = None
    ) -> None:
        """Record that a robot refused a task or failed at it.

        A refusal for the robot's present state makes a pause, and does not count towards its final answer. Nor does a
        refusal for lack of energy by a robot that has more after a charge. A task out of reach has the longest
        pause at once: each try takes the robot out of contact.

        Args:
            task_id: the task.
            robot: robot that refused it.
            reason: why.
            now_ns: the time.
            battery: of a robot that can charge.

        """
        before = self._avoided.pop((task_id, robot), None)
        times = 1 if before is None else before.times + 1
        if isinstance(reason, OutOfReach):
            times = max(times, LONGEST_AFTER)
        is_passing = isinstance(reason, Refused) and (
            isinstance(reason.because, PASSING) or _is_enough_once_charged(reason.because, battery)
        )
        final_times = (0 if before is None else before.final_times) + (not is_passing)
        pause_s = backoff_s(times, FIRST_PAUSE_S, LONGEST_PAUSE_S)
        self._avoided[task_id, robot] = _Pause(now_ns + to_ns(pause_s), times, reason, final_times)
        if len(self._avoided) > KEPT:
            del self._avoided[next(iter(self._avoided))]

    def pause_reason(self, task_id: str, robot: str, now_ns: int) -> RobotReason | None:
        """Why a robot must not be offered a task now; None if it may."""
        return _reason(self._avoided, (task_id, robot), now_ns) or self.robots.backoff_reason(robot, now_ns)

    def pauses(self, now_ns: int) -> dict[tuple[str, str], RobotReason]:
        """Which task must not be offered to which robot now, and why."""
        return {pair: avoided.reason for pair, avoided in self._avoided.items() if now_ns < avoided.until_ns}

    def last_word(self, task_id: str, robot: str) -> RobotReason | None:
        """The last answer of a robot that must not be asked again; None if it may be asked."""
        avoided = self._avoided.get((task_id, robot))
        return avoided.reason if avoided is not None and avoided.final_times >= REFUSALS_MAX else None


def _is_enough_once_charged(refusal: OfferRefusal, battery: BatteryState | None) -> bool:
    """Whether a robot refuses for lack of energy that its full battery has."""
    if battery is None or not isinstance(refusal, NeedsEnergy) or battery.soc >= CHARGED_SOC:
        return False
    return refusal.needed_j * battery.soc <= battery.remaining_j


class RobotPauses:
    """The present pauses of each robot."""

    def __init__(self) -> None:
        self._unreached: dict[str, _Pause] = {}
        self._tired: dict[str, _Pause] = {}
        self._refusals: dict[str, int] = {}

    def unreached(self, robot: str, reason: PlainReason, now_ns: int) -> None:
        """Record that an offer did not reach a robot."""
        _lengthen(self._unreached, robot, reason, now_ns)

    def refused(self, robot: str, refusal: OfferRefusal, now_ns: int) -> None:
        """Record that a robot refused one of the coordinator's own tasks."""
        self._refusals[robot] = self._refusals.get(robot, 0) + 1
        if self._refusals[robot] > REFUSALS_FREE:
            times = self._refusals[robot]
            reason = plain("refused_often", f"refused {times} times: {refusal}", times=times, because=refusal.code)
            _lengthen(self._tired, robot, reason, now_ns)

    def answered(self, robot: str) -> None:
        """Record that a robot refused a task: it can be reached."""
        self._unreached.pop(robot, None)

    def accepted(self, robot: str) -> None:
        """Record that a robot accepted a task; this ends its pauses."""
        for kept in (self._unreached, self._tired, self._refusals):
            kept.pop(robot, None)

    def backoff_reason(self, robot: str, now_ns: int) -> RobotReason | None:
        """Why a robot must not be offered anything now; None if it may."""
        return _reason(self._unreached, robot, now_ns)

    def pause_reason(self, robot: str, now_ns: int) -> RobotReason | None:
        """Why a robot must not be offered one of the coordinator's own tasks now; None if it may."""
        return _reason(self._unreached, robot, now_ns) or _reason(self._tired, robot, now_ns)


def _lengthen(pauses: dict[str, _Pause], robot: str, reason: RobotReason, now_ns: int) -> None:
    before = pauses.get(robot)
    times = 1 if before is None else before.times + 1
    pause_s = backoff_s(times, FIRST_ROBOT_PAUSE_S, LONGEST_ROBOT_PAUSE_S)
    pauses[robot] = _Pause(now_ns + to_ns(pause_s), times, reason)


class TaskGate(Protocol):
    """Parts of the coordinator as tasks meet them: they may hold requests and offers back, and know other members."""

    def request_refusal(self) -> str:
        """Why no task is accepted or cancelled, in words; empty if tasks are."""

    def when_kept(self, on_kept: Callable[[], None], on_lost: Callable[[str], None]) -> None:
        """Call `on_kept` once no change up to now can be lost with this machine, else `on_lost` with a reason."""

    def mote_quantities(self) -> Mapping[str, str]:
        """All known motes, each with the quantity that it senses."""

    def verdicts(self, record: TaskRecord, now_ns: int) -> list[RobotVerdict]:
        """Verdicts on members that are no robots."""

    def offer_refusal(self) -> TaskReason | None:
        """Why no task is offered at all; None if tasks are."""

    def task_refused(self, record: TaskRecord, robot: str, refusal: OfferRefusal, now_ns: int) -> None:
        """A robot has refused one of the coordinator's own tasks."""


class HeldElsewhere:
    """Which robot may be doing which queued task, and until when.

    Args:
        book: of the tasks.
        roster: the robots of the team.

    """

    def __init__(self, book: TaskBook, roster: Roster) -> None:
        self._book, self._roster = book, roster
        self._until: dict[str, tuple[str, int]] = {}

    def receive(self, ballot: TeamBallot, now_ns: int) -> None:
        """Read a robot's reports on itself and on others."""
        self._until = {task: one for task, one in self._until.items() if one[0] != ballot.robot and one[1] > now_ns}
        for other in ballot.absent:
            record, known = self._book.find(other.id), self._until.get(other.id)
            until_ns = now_ns + to_ns(other.remaining_s)
            is_queued = record is not None and record.state is TaskState.QUEUED
            if is_queued and other.robot != ballot.robot and (known is None or known[1] < until_ns):
                self._until[other.id] = (other.robot, until_ns)

    def by(self, task_id: str, now_ns: int) -> str:
        """The robot that may be doing a task, or an empty string. If the robot is in contact, its own state decides."""
        robot, until_ns = self._until.get(task_id, ("", now_ns))
        known = self._roster.robots.get(robot)
        if until_ns <= now_ns or known is None or known.state is None or not known.is_up(now_ns):
            return robot if until_ns > now_ns else ""
        statuses = (known.state.task, known.state.next_task)
        return robot if any(one is not None and one.id == task_id for one in statuses) else ""


class Eligibility:
    """Decides which tasks may be offered now, and which robots they exclude.

    Args:
        book: of the tasks.
        roster: the robots of the team.
        capabilities: plugins and kinds of task of the robots.
        backoff: tasks that robots refused or failed at, and until when they are not offered again.
        gate: parts that may hold offers back.
        team_map: with the zones that hold.

    """

    def __init__(
        self,
        book: TaskBook,
        roster: Roster,
        capabilities: Capabilities,
        backoff: TaskPauses,
        gate: TaskGate,
        team_map: TeamMap,
    ) -> None:
        self._book, self._roster, self._capabilities = book, roster, capabilities
        self._map = team_map
        self._backoff = backoff
        self.offer_refusal = gate.offer_refusal
        """Why no task is offered at all; None if tasks are."""
        self.held_elsewhere = HeldElsewhere(book, roster)
        """Robots that may be doing queued tasks that no coordinator gave them."""

    def wait_reason(self, record: TaskRecord, now_ns: int, travel_s: float = 0.0) -> TaskReason | None:
        """Why a task cannot be offered to any robot yet; None if it can.

        Args:
            record: of the task.
            now_ns: the time.
            travel_s: travel time of its robot, which may set out before the task's earliest time.

        """
        task = record.task
        if record.state is not TaskState.QUEUED:
            return plain("is_state", f"it is {record.state}", state=record.state)
        if record.own:
            return plain("is_own", "it is one of the coordinator itself")
        if (refusal := self.offer_refusal()) is not None:
            return refusal
        if (task.paused or self._map.shut_zones) and (reason := self.unplannable(record)) is not None:
            return reason
        if task.same_robot_as and not self._robot_of(task.same_robot_as):
            return SameRobot(task.same_robot_as)
        if holder := self.held_elsewhere.by(task.id, now_ns):
            return holder_out(holder)
        if now_ns + to_ns(travel_s) < task.earliest_ns:
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

    def unplannable(self, record: TaskRecord) -> TaskReason | None:
        """Why no plan may include a queued task yet; None if plans may."""
        if record.task.paused:
            reason = record.reason
            return reason if reason is not None and reason.code == PAUSED else plain(PAUSED, "it is paused")
        zone = self._map.shut_at(record.task.place)
        return None if zone is None else shut(zone)

    def new_task_state(self, record: TaskRecord, now_ns: int) -> TaskReason | None:
        """Conditions for a task that is not in the book before any robot could begin it; None if there are none."""
        reason = self.wait_reason(record, now_ns) or self.nobody_can(record, now_ns)
        return reason or (None if self._roster.up(now_ns) else NOBODY_THERE)

    def nobody_can(self, record: TaskRecord, now_ns: int) -> TaskReason | None:
        """Why no robot of the team can do the task; None if one can, or may."""
        other = record.task.same_robot_as
        if other and (name := self._robot_of(other)):
            robot = self._roster.robots.get(name)
            has_gone = self._roster.is_complete(now_ns) and (robot is None or robot.has_gone)
            if out := Gone() if has_gone else robot and robot.out_of_service:
                return SameRobot(other, name, out)
        return capability_refusal(record.task, self._capabilities.plugins)

    def hopeless(self, record: TaskRecord, now_ns: int) -> PlainReason | None:
        """The answers of all present and able robots, if none of them will be asked again; else None.

        A task with a deadline is kept until then.
        """
        if record.task.deadline_ns is not None:
            return None
        outs = []
        for robot in self._roster.up(now_ns):
            if self.unfit_reason(record, robot) is not None:
                continue
            reason = self._backoff.last_word(record.task.id, robot.name)
            if reason is None:
                return None
            outs.append(RobotOut(robot.name, reason))
        if not outs:
            return None
        listed, more = outs[:REPORTED_MAX], len(outs[REPORTED_MAX:])
        text = f"nobody does it: {'; '.join(map(str, listed))}{f' and {more} more' if more else ''}"
        return plain("nobody_does", text, robots=tuple(one.robot for one in listed), more=more)

    def refusal(self, record: TaskRecord, robot: Robot, now_ns: int) -> RobotReason | None:
        """Why a task is not offered to a robot; None if it may be."""
        if (unfit := self.unfit_reason(record, robot)) is not None:
            return unfit
        if (out := robot.down_reason(now_ns) or robot.out_of_service) is not None:
            return out
        if robot.state is not None and robot.state.halted:
            return halted()
        if other := self._book.of_robot(robot.name):
            return plain("at_task", f"is at {other.task.id}", task=other.task.id)
        return self._backoff.pause_reason(record.task.id, robot.name, now_ns)

    def unfit_reason(self, record: TaskRecord, robot: Robot) -> RobotReason | None:
        """Why a task is not for a robot with its present plugins; None if it may be."""
        plugins = self._capabilities.plugins.get(robot.name)
        missing = [name for name in needed_plugins(record.task) if plugins is not None and name not in plugins]
        return lacks_plugins(missing) if missing else self.barred(record.task, robot.name)

    def pauses(
        self, records: Iterable[TaskRecord], robots: Iterable[str], now_ns: int
    ) -> dict[tuple[str, str], RobotReason]:
        """Which task must not be offered to which robot now, and why."""
        found = self._backoff.pauses(now_ns)
        for task in [record.task for record in records if record.task.same_robot_as or record.task.excluded]:
            found |= {(task.id, name): barred for name in robots if (barred := self.barred(task, name)) is not None}
        return found

    def barred(self, task: Task, robot: str) -> PlainReason | None:
        """Why a task is not for a robot, whatever it can do; None if it may be."""
        other = task.same_robot_as
        if robot in task.excluded:
            return plain("excluded", "is excluded from it")
        if not other or self._robot_of(other) in ("", robot):
            return None
        return plain("other_robot", f"is not the robot of {other}", task=other)

    def _robot_of(self, task_id: str) -> str:
        """The robot that does or did a task; empty if it has none."""
        record = self._book.find(task_id)
        return "" if record is None else record.robot
