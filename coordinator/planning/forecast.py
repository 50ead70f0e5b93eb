"""When each open task begins, arrives and ends, and what it costs.

The times follow the plan in force from the present. A running task ends when its robot says. Each later task of a route
begins when the one before ends. Travel times are corrected by the median ratio of past times to planned ones. The
intervals are quantiles of the same ratios for whole estimates.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from statistics import median
from typing import NamedTuple

import msgspec
import numpy as np

from robrain.coordinator.planning.plan_in_force import PlanInForce, PlannedStep
from robrain.coordinator.planning.snapshot import HANDLING_S, AfterCharge
from robrain.coordinator.planning.snapshot_builder import left_of
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.team.roster import Roster
from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.messages.tasks.task_messages import RobotVerdict, TaskEstimate, TaskRecord
from robrain.protocol.model.tasks.task import Task, TaskState

KEPT_RATIOS = 200
"""Past tasks that count."""
PRIOR_TRAVEL_RATIOS = PRIOR_ENERGY_RATIOS = (0.95,) * 3
BEGUN, NEXT, LATER = range(3)
"""Stages of a task: its robot has begun it, its robot sets out soon, its robot sets out later."""
PRIOR_RATIOS = (
    (0.87, 0.93, 0.95, 0.97, 0.98, 0.99, 0.99, 1.00, 1.02, 1.04, 1.11),
    (0.78, 0.90, 0.93, 0.96, 0.98, 0.99, 0.99, 1.00, 1.02, 1.06, 1.20),
    (0.53, 0.72, 0.87, 0.97, 0.98, 1.00, 1.01, 1.05, 1.27, 1.74, 2.83),
)
"""Ratios of actual to estimated time before any task has ended, by stage.

They are quantiles of 672 tasks of `robrain bench estimates --scenarios depot,office`, seeds 1, 2, 103 and 104.
"""
INTERVALS = ((0.05, 0.95), (0.02, 0.98), (0.02, 0.98))
"""Quantiles that are shown as 90 % interval, by stage.

They were chosen by the same tasks. A delay of one task delays the tasks behind it, so more ends are outside.
"""
SOON_NS = to_ns(5.0)
"""Time that is soon, for the stages."""
RATIO_MAX = 10.0
MOVED_NS = to_ns(1.0)
SHORT_S = 1.0
"""Shorter travel says nothing about the ratio."""


class TaskTimes(NamedTuple):
    """Expected times of a task, by the run's clock, and its energy as the plan has it."""

    robot: str
    leave_ns: int
    arrive_ns: int
    end_ns: int
    energy_j: float
    stage: int
    is_late: bool = False


class Forecast:
    """Estimates of all open tasks.

    Args:
        book: the tasks.
        roster: the robots.
        after_charge: predicted ends of charges, by robot.
        time_margin: factor on travel times that plans contain.

    """

    def __init__(
        self, book: TaskBook, roster: Roster, after_charge: Mapping[str, AfterCharge], time_margin: float
    ) -> None:
        self._book, self._roster, self._after_charge, self.time_margin = book, roster, after_charge, time_margin
        self.times: dict[str, TaskTimes] = {}
        """Of the open tasks, as of the last update."""
        self._published: dict[str, TaskTimes] = {}
        self._steps: dict[str, PlannedStep] = {}
        """The last step of each open task that was planned before the task began."""
        self._estimated: dict[tuple[str, int], tuple[int, TaskTimes]] = {}
        """The first estimate of each open task in each stage, and when it was made."""
        self._travel_ratios = deque(PRIOR_TRAVEL_RATIOS, KEPT_RATIOS)
        self._energy_ratios = deque(PRIOR_ENERGY_RATIOS, KEPT_RATIOS)
        self._travel_ratio = self._energy_ratio = 1.0
        self._ratios = [deque(ratios, KEPT_RATIOS) for ratios in PRIOR_RATIOS]
        self._intervals = _intervals(self._ratios)

    def of(self, task_id: str, now_ns: int) -> TaskEstimate | None:
        """The estimate of a task, as of the last update; None if no plan includes it."""
        times = self.times.get(task_id)
        return None if times is None else self.estimate(task_id, times, now_ns)

    def estimate(self, task_id: str, times: TaskTimes, now_ns: int) -> TaskEstimate:
        """Times as an estimate, with its interval."""
        low, high = self._intervals[times.stage]
        ends_in_s = to_seconds(max(0, times.end_ns - now_ns))
        return TaskEstimate(
            task=task_id,
            robot=times.robot,
            starts_in_s=round(to_seconds(times.leave_ns - now_ns), 1),
            arrives_in_s=round(to_seconds(max(0, times.arrive_ns - now_ns)), 1),
            ends_in_s=round(ends_in_s, 1),
            ends_low_s=round(low * ends_in_s, 1),
            ends_high_s=round(high * ends_in_s, 1),
            energy_j=round(self._energy_ratio * times.energy_j, 1),
            is_late=times.is_late,
        )

    def corrected(self, bid: RobotVerdict) -> RobotVerdict:
        """A bid of a plan of now, by experience."""
        if bid.arrives_in_s is None or bid.energy_j is None:
            return bid
        arrives_in_s = self._travel_ratio * bid.arrives_in_s / self.time_margin
        return msgspec.structs.replace(
            bid, arrives_in_s=round(arrives_in_s, 1), energy_j=round(self._energy_ratio * bid.energy_j, 1)
        )

    def update(self, plan: PlanInForce | None, now_ns: int) -> None:
        """Follow the plan in force from the present state of the team."""
        if not (self._book.open or self._estimated):
            self.times = {}
            return
        self._learn()
        for steps in plan.steps.values() if plan is not None else ():
            self._steps |= {step.task: step for step in steps if not step.has_begun}
        self._steps = {task: step for task, step in self._steps.items() if self._book.is_open(task)}
        self.times = self.times_of(plan, self._book.open, now_ns)
        for task, times in self.times.items():
            self._estimated.setdefault((task, times.stage), (now_ns, times))

    def has_moved(self) -> bool:
        """Whether a time has moved by a second, or a task has come or gone, since this was last true."""
        before, now = self._published, self.times
        if before.keys() == now.keys() and not any(_differs(before[task], times) for task, times in now.items()):
            return False
        self._published = now
        return True

    def times_of(self, plan: PlanInForce | None, records: Sequence[TaskRecord], now_ns: int) -> dict[str, TaskTimes]:
        """The times of open tasks by a plan, from the present state of the team; of tasks that have some."""
        found: dict[str, list[tuple[str, PlannedStep]]] = {}
        for robot, steps in sorted(plan.steps.items()) if plan is not None else ():
            for step in steps:
                found.setdefault(step.task, []).append((robot, step))
        all_times: dict[str, TaskTimes] = {}
        free_ns: dict[str, int] = {}
        waiting = []
        for record in records:
            if record.own:
                continue
            if record.state is TaskState.RUNNING:
                times = self._running(record, now_ns)
                if times is not None:
                    all_times[record.task.id] = _judged(times, record.task)
                    free_ns[record.robot] = times.end_ns
            elif record.task.id in found and record.state in (TaskState.QUEUED, TaskState.OFFERED):
                waiting.append(record)
        waiting.sort(key=lambda one: (found[one.task.id][0][1].start_ns, one.task.id))
        for record in waiting:
            times = self._waiting(record, found[record.task.id], all_times, free_ns, now_ns)
            if times is not None:
                all_times[record.task.id] = _judged(times, record.task)
                for robot, _ in found[record.task.id]:
                    free_ns[robot] = times.end_ns
        return all_times

    def _running(self, record: TaskRecord, now_ns: int) -> TaskTimes | None:
        robot, step = self._roster.robots.get(record.robot), self._steps.get(record.task.id)
        state = None if robot is None else robot.state
        remaining_s = math.inf if state is None else left_of(record, state)
        if not remaining_s < math.inf:
            if step is None:
                return None
            whole_s = self._travel_s(step) + step.service_s - HANDLING_S
            remaining_s = max(0.0, whole_s - to_seconds(now_ns - record.changed_ns))
        service_s = 0.0 if step is None else step.service_s - HANDLING_S
        end_ns = now_ns + to_ns(remaining_s)
        arrive_ns = end_ns - to_ns(service_s)
        return TaskTimes(
            record.robot, record.changed_ns, arrive_ns, end_ns, 0.0 if step is None else step.energy_j, BEGUN
        )

    def _waiting(
        self,
        record: TaskRecord,
        steps: list[tuple[str, PlannedStep]],
        all_times: dict[str, TaskTimes],
        free_ns: dict[str, int],
        now_ns: int,
    ) -> TaskTimes | None:
        """The times of a task that has not begun; None if another must end before it, and no plan includes that."""
        start_ns, leave_ns, arrive_ns = max(now_ns, record.task.earliest_ns), 0, 0
        for name in record.task.after:
            other = self._book.find(name)
            if other is not None and not other.state.ended:
                if name not in all_times:
                    return None
                start_ns = max(start_ns, all_times[name].end_ns)
        for robot, step in steps:
            charged = self._after_charge.get(robot)
            begin_ns = free_ns.get(robot, max(now_ns, charged.free_ns) if charged is not None else now_ns)
            travel_ns = to_ns(self._travel_s(step) + step.charge_s)
            arrive_ns = max(arrive_ns, begin_ns + travel_ns)
            leave_ns = max(begin_ns, start_ns - travel_ns)
        start_ns = max(start_ns, arrive_ns)
        end_ns = start_ns + to_ns(steps[0][1].service_s - HANDLING_S)
        energy_j = sum(step.energy_j for _, step in steps)
        stage = NEXT if leave_ns <= now_ns + SOON_NS else LATER
        return TaskTimes(steps[0][0], leave_ns, arrive_ns, end_ns, energy_j, stage)

    def _travel_s(self, step: PlannedStep) -> float:
        return self._travel_ratio * (step.travel_s / self.time_margin + HANDLING_S)

    def _learn(self) -> None:
        """Compare the estimates of tasks that have ended with what they took."""
        has_learned = False
        for task in [
            name for name in dict.fromkeys(name for name, _ in self._estimated) if not self._book.is_open(name)
        ]:
            estimates = [self._estimated.pop((task, stage), None) for stage in (BEGUN, NEXT, LATER)]
            record, step = self._book.find(task), self._steps.pop(task, None)
            if record is None or record.state is not TaskState.DONE:
                continue
            has_learned = True
            for from_ns, times in filter(None, estimates):
                if times.end_ns > from_ns:
                    ratio = _ratio(record.changed_ns - from_ns, times.end_ns - from_ns)
                    self._ratios[times.stage].append(ratio)
            begun = estimates[BEGUN]
            if begun is not None and step is not None and step.travel_s > SHORT_S:
                actual_s = to_seconds(record.changed_ns - begun[1].leave_ns) - (step.service_s - HANDLING_S)
                self._travel_ratios.append(_ratio(actual_s, step.travel_s / self.time_margin + HANDLING_S))
                energy_j = record.result.get("energy_j")
                if isinstance(energy_j, float) and step.energy_j > 0:
                    self._energy_ratios.append(_ratio(energy_j, step.energy_j))
        if has_learned:
            self._travel_ratio, self._energy_ratio = median(self._travel_ratios), median(self._energy_ratios)
            self._intervals = _intervals(self._ratios)


def _judged(times: TaskTimes, task: Task) -> TaskTimes:
    """The times, late if the deadline will probably be missed."""
    return times if task.deadline_ns is None else times._replace(is_late=times.end_ns > task.deadline_ns)


def _differs(one: TaskTimes, other: TaskTimes) -> bool:
    moved_ns = max(abs(one.arrive_ns - other.arrive_ns), abs(one.end_ns - other.end_ns))
    names = (one.robot, one.stage, one.is_late), (other.robot, other.stage, other.is_late)
    return names[0] != names[1] or moved_ns >= MOVED_NS


def _ratio(actual: float, expected: float) -> float:
    """The ratio, within limits: robots report what they want."""
    return min(max(actual / expected, 1.0 / RATIO_MAX), RATIO_MAX)


def _intervals(ratios: Sequence[deque[float]]) -> list[tuple[float, float]]:
    """By stage, the ends of the interval as ratios to the estimated time; 1 is within."""
    ends = (np.quantile(one, levels) for one, levels in zip(ratios, INTERVALS, strict=True))
    return [(min(1.0, float(low)), max(1.0, float(high))) for low, high in ends]
