"""Orders of ROS 2 nodes to the team: tasks and halts, done on threads of their own, since they wait for answers."""

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple, Protocol

from robrain.client.team import Team
from robrain.deploy.ros2.named_values import BadValues, task_arguments
from robrain.protocol.wire.errors import RobrainError

WAITING_MAX = 32
"""Tasks that wait to be submitted."""


class Outcome(NamedTuple):
    """How an order ended."""

    done: bool
    words: str
    """Name of the task, or why not; of a halt, who has stopped and who has not."""


class Orders(Protocol):
    """To whom the gateway takes orders."""

    def submit(self, values: Mapping[str, Any]) -> "Future[Outcome]":
        """Submit a task; `values` as in `task_arguments`."""

    def halt(self) -> "Future[Outcome]":
        """Halt all robots."""


class TeamOrders:
    """Orders to a live team.

    Args:
        connect: makes a client of the team; called twice, since a halt must not wait for a task.
        by: name in the records of tasks and halts.

    """

    def __init__(self, connect: Callable[[], Team], by: str) -> None:
        self._by = by
        self._tasks, self._halts = connect(), connect()
        self._submitting = ThreadPoolExecutor(1, "ros2-submit")
        self._halting = ThreadPoolExecutor(1, "ros2-halt")
        self._waiting = 0

    def submit(self, values: Mapping[str, Any]) -> "Future[Outcome]":
        """See `Orders`."""
        if self._waiting >= WAITING_MAX:
            return _answered(Outcome(False, f"{WAITING_MAX} tasks wait to be submitted already"))
        self._waiting += 1
        future = self._submitting.submit(self._submit, dict(values))
        future.add_done_callback(self._submitted)
        return future

    def halt(self) -> "Future[Outcome]":
        """See `Orders`."""
        return self._halting.submit(self._halt)

    def close(self) -> None:
        """End, without those that have not begun."""
        for pool in (self._submitting, self._halting):
            pool.shutdown(cancel_futures=True)
        self._tasks.close()
        self._halts.close()

    def _submit(self, values: Mapping[str, Any]) -> Outcome:
        try:
            kind, arguments = task_arguments(values)
            return Outcome(True, self._tasks.submit(kind, **arguments).task.id)
        except (BadValues, RobrainError) as error:
            return Outcome(False, str(error))

    def _submitted(self, _: "Future[Outcome]") -> None:
        self._waiting -= 1

    def _halt(self) -> Outcome:
        try:
            report = self._halts.halt(by=self._by, reason="asked by a ROS 2 node")
        except RobrainError as error:
            return Outcome(False, str(error))
        lines = [f"{robot}: halted" for robot in report.confirmed]
        lines += [f"{robot}: NOT halted: {why}" for robot, why in report.unconfirmed.items()]
        return Outcome(not report.unconfirmed, "; ".join(lines))


def _answered(outcome: Outcome) -> "Future[Outcome]":
    future: Future[Outcome] = Future()
    future.set_result(outcome)
    return future
