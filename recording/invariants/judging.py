"""Judges all invariants of a run, from a recording or while it runs.

    judging = Judging(surroundings)
    run.follow(judging.receive)      # or judging.handle(message, time_ns) with decoded messages
    …
    for ruling in judging.finish(): …

An invariant is a class like those beside this file, and its line in `JUDGES`.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.codec import BadPayload
from robrain.protocol.messages.robots.robot_messages import BatteryState, RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.team.arena_messages import ArenaTruth, RobotTruth
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import LOST_AFTER_S, MEMBER_PREFIX, TaskState
from robrain.protocol.table.topic import Topic
from robrain.recording.invariants.findings import (
    ChargedAway,
    ChargeRose,
    DeliveredFell,
    Invariant,
    InvariantState,
    InWall,
    MissingEvidence,
    OutOfEnergy,
    Ruling,
    TaskAbandoned,
    TasksForgotten,
    Unbalanced,
)
from robrain.recording.invariants.halts import Halts
from robrain.recording.invariants.invariant_judge import NOWHERE, Handler, InvariantJudge, Surroundings
from robrain.recording.invariants.task_invariants import TaskAtOne, TaskChanges, TaskOnce

FORGOTTEN_AFTER_NS = to_ns(1.0)
"""A count that is too small for this long is not a change in transit (chosen: two summaries)."""
ABANDONED_AFTER_NS = to_ns(10.0)
"""A coordinator gives a task back after 2 s at the latest (chosen: five times that)."""
AWAY_AFTER_NS = to_ns(2.0)
"""A coordinator that is silent for this long is absent, and starts to listen again."""
NAMED_MAX = 5

_Given = tuple[str, str, int]
"""Task, robot and epoch."""


FELL_J = 1e-6
"""Less than this is rounding."""
RISE_SHARE = 0.05
"""Of the energy that was left: so far an interval may miss (chosen; it is one of 95 %)."""
AWAY_NS = to_ns(1.0)
"""A battery that charges away from chargers for this long does so, and was not just moved."""
CHARGER_M = 0.15
"""Beyond a charger's reach that still counts as being there."""
DOUBTED_NS = to_ns(10.0)
"""For this long after measurements were rejected the estimate is not judged."""


class _RobotEnergy:
    """A robot's energy."""

    def __init__(self) -> None:
        self.delivered_j: float | None = None
        self.place: Point2D | None = None
        self.doubted_ns: int | None = None
        self.begin: tuple[BatteryState, float] | None = None
        """Estimate, and delivered energy, at the start of the time since the last charge."""
        self.least_high_j = 0.0
        """The least upper end of the interval in this stretch."""
        self.is_reported = self.is_balance_reported = False
        """Of this stretch."""
        self.away_ns: int | None = None
        self.is_away_reported = False


class EnergyBalance(InvariantJudge):
    """Compares ground truth, chargers and estimates of energy."""

    invariant = Invariant.ENERGY

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._robots: dict[str, _RobotEnergy] = {}

    def handlers(self) -> Mapping[type, Handler]:
        """Handlers by type of message."""
        return {RobotState: self._handle_state, ArenaTruth: self._handle_truth}

    def lacks(self) -> MissingEvidence | None:
        """Evidence that is missing."""
        return None if self.cases else MissingEvidence.BATTERIES

    def _robot(self, name: str) -> _RobotEnergy:
        robot = self._robots.get(name)
        if robot is None:
            robot = self._robots[name] = _RobotEnergy()
            self.cases += 1
        return robot

    def _handle_truth(self, truth: ArenaTruth, time_ns: int) -> None:
        for now in truth.robots:
            robot = self._robot(now.robot)
            before_j = robot.delivered_j
            if before_j is not None and now.energy_j < before_j - FELL_J:
                self.break_(time_ns, DeliveredFell(robot=now.robot, before_j=before_j, now_j=now.energy_j))
                robot.begin = None  # later values are counted from here
            robot.delivered_j, robot.place = now.energy_j, Point2D(now.pose.x_m, now.pose.y_m)

    def _handle_state(self, state: RobotState, time_ns: int) -> None:
        battery = state.battery
        if battery is None:
            return
        robot = self._robot(state.robot)
        if battery.implausible:
            robot.doubted_ns = time_ns
        if state.halted:  # its plugins stand still: it reports its state at the halt
            robot.away_ns = None
        elif battery.charging:
            robot.begin = None
            self._judge_place(state.robot, robot, time_ns)
        else:
            self._judge_estimate(state.robot, robot, battery, time_ns)

    def _judge_estimate(self, name: str, robot: _RobotEnergy, battery: BatteryState, time_ns: int) -> None:
        robot.away_ns, robot.is_away_reported = None, False
        if robot.doubted_ns is not None and time_ns - robot.doubted_ns < DOUBTED_NS:
            robot.begin = None
        elif robot.begin is None:
            robot.begin, robot.least_high_j = (battery, robot.delivered_j or 0.0), battery.remaining_high_j
            robot.is_reported = robot.is_balance_reported = False
        elif battery.remaining_high_j > 0:  # a robot without an interval cannot be judged
            self._judge_rise(name, robot, battery, time_ns)
            self._judge_balance(name, robot, battery, time_ns)
            robot.least_high_j = min(robot.least_high_j, battery.remaining_high_j)

    def _judge_place(self, name: str, robot: _RobotEnergy, time_ns: int) -> None:
        place = robot.place
        if place is None or self.surroundings.chargers is None or self.surroundings.is_at_charger(place, CHARGER_M):
            robot.away_ns = None
            return
        if robot.away_ns is None:
            robot.away_ns = time_ns
        elif time_ns - robot.away_ns > AWAY_NS and not robot.is_away_reported:
            robot.is_away_reported = True
            self.break_(
                time_ns, ChargedAway(robot=name, place=place, charger_m=self.surroundings.charger_distance_m(place))
            )

    def _judge_rise(self, name: str, robot: _RobotEnergy, battery: BatteryState, time_ns: int) -> None:
        before_j, now_j = robot.least_high_j, battery.remaining_low_j
        if now_j > before_j * (1.0 + RISE_SHARE) and not robot.is_reported:
            robot.is_reported = True
            self.break_(time_ns, ChargeRose(robot=name, before_j=before_j, now_j=now_j))

    def _judge_balance(self, name: str, robot: _RobotEnergy, battery: BatteryState, time_ns: int) -> None:
        if robot.begin is None or robot.delivered_j is None or robot.is_balance_reported:
            return
        begin, begun_j = robot.begin
        delivered_j = robot.delivered_j - begun_j
        least_j = begin.remaining_low_j - battery.remaining_high_j
        most_j = begin.remaining_high_j - battery.remaining_low_j
        slack_j = RISE_SHARE * begin.remaining_high_j
        if least_j - slack_j <= delivered_j <= most_j + slack_j:
            return
        robot.is_balance_reported = True
        finding = Unbalanced(
            robot=name, delivered_j=round(delivered_j, 1), least_j=round(least_j, 1), most_j=round(most_j, 1)
        )
        self.break_(time_ns, finding)


class TaskKept(InvariantJudge):
    """Compares the coordinator's counts with its changes, and the robots' reports with both."""

    invariant = Invariant.TASK_KEPT

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._changes = TaskChanges()
        self._changed_ns: dict[str, int] = {}
        self._begins_empty: bool | None = None
        self._summary_ns: int | None = None
        self._summary_seq: int | None = None
        self._may_lack = False
        """Whether summaries are missing since the last change, so that changes may be as well."""
        self._too_few: tuple[int, int] | None = None
        """Tasks that are missing, and since when."""
        self._agreed_ns = start_ns
        self._reported_missing = 0
        self._since_ns: dict[_Given, int] = {}
        """Since when a task has been at its robot without a report of it."""
        self._reported: set[_Given] = set()
        self._received_ns: dict[str, int] = {}

    def handlers(self) -> Mapping[type, Handler]:
        """Handlers by type of message."""
        return {TaskEvent: self._handle_event, RobotState: self._handle_state, TeamState: self._handle_summary}

    def lacks(self) -> MissingEvidence | None:
        """Evidence that is missing."""
        changes = self._changes
        if self._summary_ns is None:
            return MissingEvidence.SUMMARIES
        if not self._is_complete:
            return MissingEvidence.START
        return MissingEvidence.EVENTS if changes.has_gap or self._may_lack else None

    @property
    def _is_complete(self) -> bool:
        """Whether all tasks that are open can be known."""
        return self._changes.is_from_start or bool(self._begins_empty)

    def _handle_event(self, event: TaskEvent, time_ns: int) -> None:
        self._changes.handle(event, time_ns)
        self._may_lack = False  # the number of this one shows it
        self.cases = self._changes.tasks
        self._changed_ns[event.task.id] = time_ns
        if event.state.ended:
            self._changed_ns.pop(event.task.id)

    def _handle_state(self, state: RobotState, time_ns: int) -> None:
        self._received_ns[state.robot] = time_ns
        for status in (state.task, state.next_task, state.task_before):
            if status is not None and not status.state.ended:
                given = (status.id, state.robot, status.epoch)
                if given in self._since_ns:
                    self._since_ns[given] = time_ns

    def _handle_summary(self, summary: TeamState, time_ns: int) -> None:
        if self._begins_empty is None:
            self._begins_empty = summary.tasks_open == 0 and self._changes.tasks == 0
        if self._summary_ns is None or time_ns - self._summary_ns > AWAY_AFTER_NS:
            self._since_ns.clear()
        self._summary_ns = time_ns
        self._may_lack |= self._summary_seq is not None and summary.seq not in (self._summary_seq + 1, 0)
        self._summary_seq = summary.seq
        if self._changes.has_gap or self._may_lack:  # open tasks, and their robots, are unknown
            self._since_ns.clear()
            return
        if summary.unwritable:  # it must not change tasks that it cannot write
            self._since_ns.clear()
        if self._is_complete:
            self._compare_counts(summary, time_ns)
        self._find_abandoned(summary, time_ns)

    def _compare_counts(self, summary: TeamState, time_ns: int) -> None:
        missing = len(self._changes.open) - summary.tasks_open
        if missing <= self._reported_missing:
            self._reported_missing = max(0, missing)
            self._too_few, self._agreed_ns = None, time_ns
            return
        if self._too_few is None or self._too_few[0] != missing:
            self._too_few = missing, time_ns
        if time_ns - self._too_few[1] < FORGOTTEN_AFTER_NS:
            return
        named = self._candidates(missing - self._reported_missing)
        self.break_(
            time_ns,
            TasksForgotten(missing=missing - self._reported_missing, tasks=tuple(named[:NAMED_MAX]), of=len(named)),
        )
        self._reported_missing, self._too_few, self._agreed_ns = missing, None, time_ns

    def _candidates(self, missing: int) -> list[str]:
        """Open tasks that the coordinator may have lost: those that changed since its count was right, if enough."""
        latest = sorted(self._changes.open, key=lambda task: -self._changed_ns.get(task, 0))
        lately = [task for task in latest if self._changed_ns.get(task, 0) >= self._agreed_ns]
        return lately if len(lately) >= missing else latest

    def _find_abandoned(self, summary: TeamState, time_ns: int) -> None:
        up = {robot.name for robot in summary.robots if robot.up}
        since: dict[_Given, int] = {}
        for task, event in self._changes.open.items():
            robot = event.robot
            if not robot or robot.startswith(MEMBER_PREFIX) or event.state is TaskState.QUEUED:
                continue
            given = (task, robot, event.epoch)
            since[given] = self._since_ns.get(given, time_ns)
            silent_ns = time_ns - self._received_ns.get(robot, self._start_ns)
            if robot in up and silent_ns > to_ns(LOST_AFTER_S):
                since[given] = time_ns  # the coordinator receives a robot whose messages are missing here
            elif time_ns - since[given] > ABANDONED_AFTER_NS and given not in self._reported:
                self._reported.add(given)
                for_s = round(to_seconds(time_ns - since[given]), 3)
                self.break_(time_ns, TaskAbandoned(task=task, robot=robot, state=event.state, for_s=for_s))
        self._since_ns = since
        self._reported &= since.keys()


EMPTY_AFTER_S = 2.0
"""A battery that has delivered nothing for this long has cut off (chosen: ten periods of the battery manager)."""
EMPTY_SOC = 0.001
"""State of charge below which a robot reports that it is empty."""
CHARGES_NS = to_ns(5.0)
"""A robot that reported to be charged no longer ago is at a charger."""
SLACK_M = 0.1
"""Beyond a charger's reach that still counts as being there."""


class _Robot:
    """A robot's energy."""

    def __init__(self) -> None:
        self.state: RobotState | None = None
        self.charged_ns: int | None = None
        """Time of its last report that it is charged."""
        self.energy_j: float | None = None
        self.since_s = 0.0
        """Since when the truth has had the same `energy_j`."""
        self.empty_ns: int | None = None
        """Time since which it reports that it is empty."""
        self.is_reported = False


class NotStranded(InvariantJudge):
    """Detects robots whose batteries deliver nothing."""

    invariant = Invariant.NOT_STRANDED

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._robots: dict[str, _Robot] = {}
        self._has_truth = False

    def handlers(self) -> Mapping[type, Handler]:
        """Handlers by type of message."""
        return {RobotState: self._handle_state, ArenaTruth: self._handle_truth}

    def lacks(self) -> MissingEvidence | None:
        """Evidence that is missing."""
        return None if self.cases else MissingEvidence.BATTERIES

    def _handle_state(self, state: RobotState, time_ns: int) -> None:
        robot = self._robots.setdefault(state.robot, _Robot())
        battery = state.battery
        self.cases += not self._has_truth and battery is not None and _battery_of(robot) is None
        robot.state = state
        if battery is None:
            return
        if battery.charging:
            robot.charged_ns = time_ns
        if self._has_truth:
            return
        if battery.charging or battery.implausible or (battery.soc > EMPTY_SOC and battery.remaining_high_j > 0):
            robot.empty_ns, robot.is_reported = None, False
        elif robot.empty_ns is None:
            robot.empty_ns = time_ns
        elif time_ns - robot.empty_ns > to_ns(EMPTY_AFTER_S) and not robot.is_reported:
            pose = state.pose
            place = None if pose is None or state.lost else Point2D(pose.x_m, pose.y_m)
            self._stranded(state.robot, robot, place, time_ns, is_true=False)

    def _handle_truth(self, truth: ArenaTruth, time_ns: int) -> None:
        if not self._has_truth:
            self._has_truth, self.cases = True, len(truth.robots)
        for now in truth.robots:
            robot = self._robots.setdefault(now.robot, _Robot())
            if robot.energy_j is None or now.energy_j != robot.energy_j:
                robot.energy_j, robot.since_s, robot.is_reported = now.energy_j, truth.sim_time_s, False
            elif truth.sim_time_s - robot.since_s > EMPTY_AFTER_S and not robot.is_reported:
                self._judge_empty(now, robot, time_ns)

    def _judge_empty(self, now: RobotTruth, robot: _Robot, time_ns: int) -> None:
        place = Point2D(now.pose.x_m, now.pose.y_m)
        charges = robot.charged_ns is not None and time_ns - robot.charged_ns < CHARGES_NS
        if not charges and not self.surroundings.is_at_charger(place, SLACK_M):
            self._stranded(now.robot, robot, place, time_ns, is_true=True)

    def _stranded(self, name: str, robot: _Robot, place: Point2D | None, time_ns: int, *, is_true: bool) -> None:
        robot.is_reported = True
        battery = _battery_of(robot)
        charger_m = None if place is None else self.surroundings.charger_distance_m(place)
        finding = OutOfEnergy(
            robot=name,
            place=place,
            charger_m=None if charger_m is None else round(charger_m, 3),
            soc=None if battery is None else battery.soc,
            is_true=is_true,
        )
        self.break_(time_ns, finding)


def _battery_of(robot: _Robot) -> BatteryState | None:
    return None if robot.state is None else robot.state.battery


DEPTH_M = 0.03
"""Least depth of a violation: a solver's remaining overlap, and the raster of the floor (chosen)."""
CARRIED_M_S = 3.0
"""No robot drives that fast: the robot was carried, and the motion in between is not judged."""


class Walls(InvariantJudge):
    """Compares true poses with the floor."""

    invariant = Invariant.WALLS

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        super().__init__(surroundings, start_ns)
        self._radius_m: dict[str, float] = {}
        self._inside: set[str] = set()
        self._last: dict[str, tuple[Pose2D, int]] = {}
        self._has_truth = False

    def handlers(self) -> Mapping[type, Handler]:
        """Handlers by type of message."""
        return {RobotState: self._handle_state, ArenaTruth: self._handle_truth}

    def lacks(self) -> MissingEvidence | None:
        """Evidence that is missing."""
        if not self._has_truth:
            return MissingEvidence.TRUTH
        if self.surroundings.clearance_m is None:
            return self.surroundings.no_floor
        return None if self.cases else MissingEvidence.RADIUS

    def _handle_state(self, state: RobotState, _time_ns: int) -> None:
        if state.radius_m > 0:
            self._radius_m[state.robot] = state.radius_m

    def _handle_truth(self, truth: ArenaTruth, time_ns: int) -> None:
        self._has_truth = True
        if self.surroundings.clearance_m is None:
            return
        for robot in truth.robots:
            radius_m = self._radius_m.get(robot.robot)
            if radius_m is not None:
                self.cases += 1
                self._judge(robot.robot, radius_m, robot.pose, time_ns)
                self._last[robot.robot] = robot.pose, time_ns

    def _judge(self, robot: str, radius_m: float, pose: Pose2D, time_ns: int) -> None:
        clearance_m = self.surroundings.clearance_m
        assert clearance_m is not None
        depth_m, place = -math.inf, Point2D(pose.x_m, pose.y_m)
        for at in self._way(robot, radius_m, pose, time_ns):
            if (deep_m := radius_m - clearance_m(at.x_m, at.y_m)) > depth_m:
                depth_m, place = deep_m, at
        if depth_m <= DEPTH_M:
            self._inside.discard(robot)
        elif robot not in self._inside:
            self._inside.add(robot)
            self.break_(time_ns, InWall(robot=robot, place=place, depth_m=round(depth_m, 4)))

    def _way(self, robot: str, radius_m: float, pose: Pose2D, time_ns: int) -> list[Point2D]:
        """The place, and before it the points on the path there that are a radius apart: no wall fits between them."""
        end = Point2D(pose.x_m, pose.y_m)
        last = self._last.get(robot)
        if last is None:
            return [end]
        (begin, begin_ns), path_m = last, last[0].distance_m(end)
        if path_m <= radius_m or path_m > CARRIED_M_S * to_seconds(time_ns - begin_ns):
            return [end]
        steps = math.ceil(path_m / radius_m)
        return [
            Point2D(begin.x_m + (end.x_m - begin.x_m) * step / steps, begin.y_m + (end.y_m - begin.y_m) * step / steps)
            for step in range(1, steps + 1)
        ]


JUDGES: tuple[type[InvariantJudge], ...] = (TaskKept, TaskAtOne, TaskOnce, NotStranded, Walls, Halts, EnergyBalance)
"""One for each invariant, in the order in which they are shown."""


class Judging:
    """Judges the messages of one run, in the order in which they were recorded.

    Args:
        surroundings: data that the messages do not have; invariants that need them are not judged without.
        start_ns: the run's clock at its start, from which the times of findings count.
        judges: of the invariants that are judged.

    """

    def __init__(
        self,
        surroundings: Surroundings = NOWHERE,
        start_ns: int = 0,
        judges: Sequence[type[InvariantJudge]] = JUDGES,
    ) -> None:
        self._judges = [judge(surroundings, start_ns) for judge in judges]
        self._handlers: dict[type, list[Handler]] = {}
        for judge in self._judges:
            for kind, handler in judge.handlers().items():
                self._handlers.setdefault(kind, []).append(handler)

    def handle(self, message: Any, time_ns: int) -> None:
        """The next message, and the run's clock when it was recorded; most are of no interest."""
        for handler in self._handlers.get(type(message), ()):
            handler(message, time_ns)

    def receive(self, heard: Sequence[tuple[Topic[Any], str, bytes, int, int]], now_ns: int) -> None:
        """Receive recorded messages: for `LockstepRun.follow`."""
        handlers = self._handlers
        for topic, _, payload, _, _ in heard:
            if topic.message in handlers:
                try:
                    message = topic.payloads.read(payload)
                except BadPayload:  # not of the team: its border refuses such as well
                    continue
                self.handle(message, now_ns)

    def finish(self) -> list[Ruling]:
        """Verdict on each invariant, in the order of the judges; to be called when the run has ended."""
        return [judge.ruling() for judge in self._judges]


def judge(
    messages: Iterable[tuple[Any, int]],
    surroundings: Surroundings = NOWHERE,
    start_ns: int = 0,
) -> list[Ruling]:
    """Judge decoded messages, each with the run's clock when it was recorded."""
    judging = Judging(surroundings, start_ns)
    for message, time_ns in messages:
        judging.handle(message, time_ns)
    return judging.finish()


def broken(rulings: Iterable[Ruling]) -> int:
    """Number of broken invariants."""
    return sum(ruling.standing is InvariantState.BROKEN for ruling in rulings)
