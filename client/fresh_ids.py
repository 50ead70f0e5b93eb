"""New ids for tasks and missions, numbered for each kind."""

import re
from collections.abc import Callable, Iterable
from typing import TypeVar

from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.tasks.mission_messages import MissionStatus
from robrain.protocol.messages.tasks.task_messages import TaskRecord

AcceptedT = TypeVar("AcceptedT", TaskRecord, MissionStatus)


class FreshIds:
    """Counts on, for each kind of task or mission, from the largest number that the team has.

    Args:
        known: ids of the tasks of a kind, or missions of a name, that the coordinator knows.
        is_known: whether the coordinator knows a task of an id, of any kind.

    """

    def __init__(self, known: Callable[[str], Iterable[str]], is_known: Callable[[str], bool]) -> None:
        self._known = known
        self._is_known = is_known
        self._next: dict[str, int] = {}

    def submit(self, kind: str, submit: Callable[[str], AcceptedT], by: str) -> AcceptedT:
        """Submit a task under the next free id.

        If another client uses the id at the same moment, the coordinator refuses the request. If both requests are
        equal, the coordinator answers with the other client's record. In both cases the next id is tried.

        Args:
            kind: kind of the task.
            submit: submits the task under an id.
            by: name of the requester.

        Raises:
            CallError: the task is refused for another reason.

        """
        if kind not in self._next:
            self._next[kind] = 1 + max((_number(kind, task) for task in self._known(kind)), default=0)
        while True:
            task_id = f"{kind}-{self._next[kind]}"
            try:
                record = submit(task_id)
            except CallError as error:
                if error.code is not ErrorCode.REFUSED or not self._is_known(task_id):
                    raise
                self._next[kind] += 1
                continue
            self._next[kind] += 1
            if record.by == by:
                return record


def _number(kind: str, task_id: str) -> int:
    found = re.fullmatch(rf"{re.escape(kind)}-([0-9]{{1,9}})", task_id)
    return int(found[1]) if found else 0
