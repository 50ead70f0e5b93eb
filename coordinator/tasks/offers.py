"""Offers and withdrawals in flight; and `dispatch`, which assigns robots without a planner.

Offers do not wait for their answers, so a stopped robot or a broken link delays no other robot. In lockstep the answer
arrives at once. At most two offers and one withdrawal per robot are in flight within the time limit.
"""

import logging
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from robrain.coordinator.team.roster import Robot
from robrain.protocol.answers.later import Later
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer, TaskOffer, TaskWithdrawal
from robrain.protocol.messages.tasks.task_messages import RobotVerdict, TaskRecord
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.reasons import RobotReason, plain, position_unknown
from robrain.protocol.table.topics import ROBOT_OFFER, ROBOT_WITHDRAW
from robrain.protocol.wire.endpoint import Endpoint

logger = logging.getLogger(__name__)

ASK_TIMEOUT_S = 0.5
"""Time limit for an answer, well below the lease; after that, only the robot's state counts."""


class Answered(NamedTuple):
    """A robot's answer to an offer."""

    record: TaskRecord
    """The record at the time of the offer."""
    after: str
    answer: TaskAnswer
    is_reached: bool = True
    """False if no queryable answered: a robot that reconnects may send states before it can be queried."""


class _Asked(NamedTuple):
    record: TaskRecord
    after: str
    reply: Later[Any]


class _Withdrawn(NamedTuple):
    robot: str
    task: str
    reply: Later[Any]


class Offers:
    """Sends offers and withdrawals.

    Args:
        wire: the coordinator's Zenoh endpoint.
        lease_s: silence of the coordinator after which a robot releases its task.

    """

    def __init__(self, wire: Endpoint, lease_s: float) -> None:
        self._wire = wire
        self._lease_s = lease_s
        self._asked: list[_Asked] = []
        self._withdrawn: list[_Withdrawn] = []

    def offer(self, record: TaskRecord, after: str) -> None:
        """Offer a record's task to its robot, to begin now or after its running task `after`."""
        offer = TaskOffer(task=record.task, epoch=record.epoch, lease_s=self._lease_s, after=after)
        trace = self._wire.traces.of(record.task.id)
        reply = self._wire.ask_later(ROBOT_OFFER, offer, robot=record.robot, timeout_s=ASK_TIMEOUT_S, trace=trace)
        self._asked.append(_Asked(record, after, reply))

    def withdraw(self, robot: str, withdrawal: TaskWithdrawal) -> None:
        """Ask a robot to withdraw from a task; its state reports the result."""
        reply = self._wire.ask_later(ROBOT_WITHDRAW, withdrawal, robot=robot, timeout_s=ASK_TIMEOUT_S)
        self._withdrawn.append(_Withdrawn(robot, withdrawal.id, reply))

    @property
    def is_waiting(self) -> bool:
        """Whether an answer is still to come or to be taken."""
        return bool(self._asked or self._withdrawn)

    def answered(self) -> list[Answered]:
        """Return the answers since the last call, in the order of the offers."""
        self._withdrawn = [one for one in self._withdrawn if not _is_over(one)]
        asked, self._asked = self._asked, []
        found = []
        for one in asked:
            try:
                answer = one.reply.take()
                if answer is None:
                    self._asked.append(one)
                    continue
            except CallError as error:
                if error.code is ErrorCode.TIMEOUT:
                    continue  # it may have accepted: its next state or the lease decides
                answer = TaskAnswer(accepted=False, why=str(error))
            except NobodyThere as error:
                found.append(Answered(one.record, one.after, TaskAnswer(accepted=False, why=str(error)), False))
                continue
            found.append(Answered(one.record, one.after, answer))
        return found


def _is_over(one: _Withdrawn) -> bool:
    try:
        return one.reply.take() is not None
    except (CallError, NobodyThere) as error:
        logger.debug("%s: task %s could not be withdrawn: %s", one.robot, one.task, error)
        return True


Refusal = Callable[[TaskRecord, Robot], RobotReason | None]
"""Why a task must not go to a robot now; None if it may."""


def dispatch(ready: Sequence[TaskRecord], idle: Sequence[Robot], refusal: Refusal) -> list[tuple[str, str]]:
    """Assign each ready task to the nearest idle robot that is left.

    Args:
        ready: queued tasks that can begin.
        idle: robots that can take one task each.
        refusal: why a robot is excluded from a task.

    Returns:
        Task and robot of each offer, the most urgent first.

    """
    left = {robot.name: robot for robot in idle}
    offers = []
    for record in sorted(ready, key=_urgency):
        if not left:
            break
        able = [
            (distance_m, name)
            for name, robot in left.items()
            if (distance_m := _distance_m(record.task, robot)) is not None and refusal(record, robot) is None
        ]
        if able:
            chosen = min(able)[1]
            del left[chosen]
            offers.append((record.task.id, chosen))
    return offers


def verdicts(record: TaskRecord, robots: Sequence[Robot], refusal: Refusal, chosen: str = "") -> list[RobotVerdict]:
    """Each robot's distance from a task, and whether it was chosen or why it is excluded."""
    found = []
    for robot in robots:
        distance_m = _distance_m(record.task, robot)
        is_chosen = robot.name == chosen
        reason = None if is_chosen else refusal(record, robot)
        if reason is None and distance_m is None:
            reason = position_unknown()
        if reason is None and chosen and not is_chosen:
            reason = plain("another_nearer", f"{chosen} is nearer", robot=chosen)
        rounded_m = None if distance_m is None else round(distance_m, 2)
        found.append(RobotVerdict.judged(robot.name, reason, chosen=is_chosen, distance_m=rounded_m))
    return found


def _urgency(record: TaskRecord) -> tuple[float, float, int]:
    deadline_ns = record.task.deadline_ns
    return (-record.task.priority, math.inf if deadline_ns is None else deadline_ns, record.submitted_ns)


def _distance_m(task: Task, robot: Robot) -> float | None:
    pose = robot.state.pose if robot.state is not None else None
    place = task.place
    return None if pose is None else math.hypot(pose.x_m - place.x_m, pose.y_m - place.y_m)
