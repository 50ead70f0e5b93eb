"""Costs of tasks at their places, queried from the robots' plugins.

One query asks for many tasks. An answer holds for all tasks of that kind with the same service time and parameters, and
for all robots that announce the kind alike. A few queries are therefore enough for any number of tasks and robots.
"""

from collections.abc import Collection, Iterable
from typing import NamedTuple

import msgspec

from robrain.coordinator.team.capabilities import Capabilities
from robrain.protocol.clock import to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.tasks.offer_messages import ROBOT_COSTS, CostsRequest, TaskCost
from robrain.protocol.model.energy_model import Work
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.wire.endpoint import Endpoint

QUERY_TASKS_MAX = 256
ANSWER_NS = to_ns(1.0)
"""A robot that has not answered within this counts as silent, and another of its type is asked."""
PATIENCE_NS = to_ns(3.0)
"""After this a task is planned without an answer; its robot checks its energy by itself. Robots of a type that has been
silent for longer are still asked, but their next tasks do not wait: a robot need not answer."""
KEPT_COSTS = 10_000


class _Key(NamedTuple):
    announcement: int
    """Number of the announcement of the kind, shared by robots of one type."""
    service_s: float
    parameters: bytes


class _CostQuery(NamedTuple):
    robot: str
    task: str
    """The task that was sent on behalf of all with this key."""
    asked_ns: int
    attempt: int


class _Known(NamedTuple):
    version: int
    """Version of the announcements."""
    task: Task
    works: tuple[Work, ...]


class TaskCosts:
    """Queries the cost of tasks from robots, without waiting for the answers.

    Args:
        wire: the coordinator's endpoint.
        capabilities: which robot does which kinds.

    """

    def __init__(self, wire: Endpoint, capabilities: Capabilities) -> None:
        self._wire = wire
        self._capabilities = capabilities
        self._inbox = Inbox()
        self._costs: dict[_Key, Work | None] = {}
        """None if a robot cannot estimate it."""
        self._questions: dict[_Key, _CostQuery] = {}
        """The last query without an answer."""
        self._silent_ns: dict[int, int] = {}
        """By announcement: time of the first query since the last answer."""
        self._version = -1
        self._version_ns = 0
        """Since when the announcements are unchanged."""
        self._first_ns: dict[str, int] = {}
        self._known: dict[str, _Known] = {}
        self.is_waiting = False
        """Whether the cost of an open task is still unknown."""

    def follow(self, tasks: Iterable[Task], up: Collection[str], now_ns: int) -> None:
        """Process answers, and query missing costs.

        Args:
            tasks: all tasks to be planned.
            up: names of the robots that can be queried.
            now_ns: the time.

        """
        for received in self._inbox.drain():
            for cost in received.message:
                self._handle_cost(received.names["robot"], cost)
        if self._version != self._capabilities.version:
            self._version, self._version_ns = self._capabilities.version, now_ns
        open_ids = set()
        missing: dict[str, list[Task]] = {}
        for task in tasks:
            open_ids.add(task.id)
            since_ns = max(self._first_ns.setdefault(task.id, now_ns), self._version_ns)
            known = self._known.get(task.id)
            if known is not None and (known.version, known.task) == (self._version, task):
                continue
            keys = self._keys(task)
            unknown = [key for key in keys if key not in self._costs]
            for key in unknown:
                if robot := self._to_be_asked(task, key, keys[key], up, now_ns):
                    missing.setdefault(robot, []).append(task)
            asked_ns = (self._silent_ns.get(key.announcement, since_ns) for key in unknown)
            if any(now_ns - one_ns <= PATIENCE_NS for one_ns in asked_ns):
                continue  # earlier answers hold until then
            found = (self._costs.get(key) for key in keys)
            works = tuple(dict.fromkeys(one for one in found if one is not None))
            self._known[task.id] = _Known(self._version, task, works)
        for gone in self._first_ns.keys() - open_ids:
            self._first_ns.pop(gone)
            self._known.pop(gone, None)
        self.is_waiting = len(self._known) < len(self._first_ns)
        if not self._first_ns:
            self._questions.clear()
        for robot, asked in missing.items():
            for start in range(0, len(asked), QUERY_TASKS_MAX):
                request = CostsRequest(tasks=asked[start : start + QUERY_TASKS_MAX])
                self._wire.ask_into(self._inbox, ROBOT_COSTS, ROBOT_COSTS, request, robot=robot)

    def of(self, task: Task) -> tuple[Work, ...] | None:
        """Cost of a task for each type of robot that can do it; empty if unknown, None if answers are pending."""
        known = self._known.get(task.id)
        return None if known is None or known.task != task else known.works

    def _keys(self, task: Task) -> dict[_Key, list[str]]:
        """The keys of a task, and the robots that can answer for each."""
        parameters = msgspec.json.encode(task.parameters, order="deterministic")
        keys: dict[_Key, list[str]] = {}
        for robot, announcement in self._capabilities.announcements(task.kind):
            keys.setdefault(_Key(announcement, task.service_s, parameters), []).append(robot)
        return keys

    def _to_be_asked(self, task: Task, key: _Key, robots: list[str], up: Collection[str], now_ns: int) -> str:
        """The robot to query now; empty if an answer is pending, or no robot is present."""
        question = self._questions.get(key)
        if question is not None and now_ns - question.asked_ns <= ANSWER_NS:
            return ""
        able = [robot for robot in robots if robot in up]
        if not able:
            return ""
        attempt = 0 if question is None else question.attempt + 1
        robot = able[attempt % len(able)]
        self._questions[key] = _CostQuery(robot, task.id, now_ns, attempt)
        self._silent_ns.setdefault(key.announcement, now_ns)
        return robot

    def _handle_cost(self, robot: str, cost: TaskCost) -> None:
        asked = ((key, one) for key, one in self._questions.items() if (one.robot, one.task) == (robot, cost.id))
        key, _ = next(asked, (None, None))
        if key is None:  # not asked for, or answered by another robot
            return
        del self._questions[key]
        self._silent_ns.pop(key.announcement, None)
        work = msgspec.convert(cost, Work, from_attributes=True)
        self._costs[key] = None if cost.why else work
        if len(self._costs) > KEPT_COSTS:
            del self._costs[next(iter(self._costs))]
