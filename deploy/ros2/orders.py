"""Orders of ROS 2 nodes to the team: tasks and halts, done on threads of their own, since they wait for answers."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple, Protocol

import msgspec

from robrain.client.team import Team
from robrain.protocol.wire.errors import RobrainError

WAITING_MAX = 32
"""Tasks that wait to be submitted, and halts likewise."""
TEXT_MAX = 65_536
"""Characters of a task."""


class OrderOutcome(NamedTuple):
    """What became of an order."""

    accepted: bool
    text: str
    """The task as JSON, the robots that have stopped, or why not."""


class Orders(Protocol):
    """To whom the gateway takes orders."""

    def submit(self, text: str) -> "Future[OrderOutcome]":
        """Submit a task, given as JSON."""

    def halt(self) -> "Future[OrderOutcome]":
        """Halt all robots."""


class AskedTask(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A task as ROS 2 nodes submit it; the fields are those of `Team.submit`."""

    kind: str
    id: str | None = None
    place: tuple[float, float] | None = None
    priority: float | None = None
    earliest_s: float | None = None
    deadline_s: float | None = None
    service_s: float | None = None
    needs: list[str] = []
    after: list[str] = []
    robots: int | None = None
    parameters: dict[str, Any] = {}


class TeamOrders:
    """Orders to a live team.

    Args:
        connect: makes a client of the team; called twice, since a halt must not wait for a task.
        by: name in the records of tasks and halts.

    """

    def __init__(self, connect: Callable[[], Team], by: str) -> None:
        self._by = by
        self._tasks, self._halts = connect(), connect()
        self._submitting = _Desk("ros2-submit")
        self._halting = _Desk("ros2-halt")

    def submit(self, text: str) -> "Future[OrderOutcome]":
        """See `Orders`."""
        return self._submitting.put(lambda: submit(self._tasks, text))

    def halt(self) -> "Future[OrderOutcome]":
        """See `Orders`."""
        return self._halting.put(lambda: halt(self._halts, self._by))

    def close(self) -> None:
        """End, without those that have not begun."""
        self._submitting.close()
        self._halting.close()
        self._tasks.close()
        self._halts.close()


def submit(team: Team, text: str) -> OrderOutcome:
    """Submit a task that is given as JSON; waits for the coordinator."""
    if len(text) > TEXT_MAX:
        return OrderOutcome(False, f"expected a task of at most {TEXT_MAX} characters, got {len(text)}")
    try:
        asked = msgspec.json.decode(text, type=AskedTask)
        fields = {name: getattr(asked, name) for name in asked.__struct_fields__ if name != "kind"}
        return OrderOutcome(True, msgspec.json.encode(team.submit(asked.kind, **fields)).decode())
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        return OrderOutcome(False, f'expected a task as JSON, such as {{"kind": "visit", "place": [1, 2]}}: {error}')
    except RobrainError as error:
        return OrderOutcome(False, str(error))


def halt(team: Team, by: str) -> OrderOutcome:
    """Halt all robots; waits until they have stopped, or for two seconds."""
    try:
        report = team.halt(reason="asked by a ROS 2 node", by=by)
    except RobrainError as error:
        return OrderOutcome(False, str(error))
    lines = [f"{robot}: halted" for robot in report.confirmed]
    lines += [f"{robot}: NOT halted: {why}" for robot, why in report.unconfirmed.items()]
    return OrderOutcome(not report.unconfirmed, "; ".join(lines))


class _Desk:
    """Does orders one after the other on a thread."""

    def __init__(self, name: str) -> None:
        self._pool = ThreadPoolExecutor(1, name)
        self._open: list[Future[OrderOutcome]] = []

    def put(self, order: Callable[[], OrderOutcome]) -> "Future[OrderOutcome]":
        self._open = [future for future in self._open if not future.done()]
        if len(self._open) >= WAITING_MAX:
            refused: Future[OrderOutcome] = Future()
            refused.set_result(OrderOutcome(False, f"{WAITING_MAX} orders wait already"))
            return refused
        future = self._pool.submit(order)
        self._open.append(future)
        return future

    def close(self) -> None:
        self._pool.shutdown(cancel_futures=True)
