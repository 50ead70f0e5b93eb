"""Offers and withdrawals on their way: robots are asked, and nobody waits for what they say.

A robot that is stopped, or whose link has gone, so holds up nobody else. In lockstep the answer is there at once. As
many are on their way as robots have been asked within the time limit: two offers each at the most, and a withdrawal.
"""

import logging
from typing import Any, NamedTuple

from robrain.protocol.wire.answers.later import Later
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.wire.messages.offer_messages import TaskAnswer, TaskOffer, TaskWithdrawal
from robrain.protocol.wire.messages.task_messages import TaskRecord
from robrain.protocol.wire.topics import ROBOT_OFFER, ROBOT_WITHDRAW

logger = logging.getLogger(__name__)

ASK_TIMEOUT_S = 0.5
"""What is answered later than this counts by the robot's state only; it must be well below the lease."""


class Answered(NamedTuple):
    """What a robot says to an offer."""

    record: TaskRecord
    """As it was offered."""
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
    """Asks robots.

    Args:
        wire: the coordinator's place on the wire.
        lease_s: a robot lets go of its task after so long without a word of its coordinator.

    """

    def __init__(self, wire: Endpoint, lease_s: float) -> None:
        self._wire = wire
        self._lease_s = lease_s
        self._asked: list[_Asked] = []
        self._withdrawn: list[_Withdrawn] = []

    def offer(self, record: TaskRecord, after: str) -> None:
        """Ask a record's robot to do it, now or after the task that it is at."""
        offer = TaskOffer(task=record.task, epoch=record.epoch, lease_s=self._lease_s, after=after)
        reply = self._wire.ask_later(ROBOT_OFFER, offer, robot=record.robot, timeout_s=ASK_TIMEOUT_S)
        self._asked.append(_Asked(record, after, reply))

    def withdraw(self, robot: str, withdrawal: TaskWithdrawal) -> None:
        """Tell a robot to let go of a task; its state tells what came of it."""
        reply = self._wire.ask_later(ROBOT_WITHDRAW, withdrawal, robot=robot, timeout_s=ASK_TIMEOUT_S)
        self._withdrawn.append(_Withdrawn(robot, withdrawal.id, reply))

    def answered(self) -> list[Answered]:
        """What has been said to offers since the last time, in the order of the offers."""
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
                    continue  # it may have taken it all the same: its next state will tell, or the lease runs out
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
