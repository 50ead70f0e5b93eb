"""Readable names for tasks that were given none: `visit-1`, then `visit-2`."""

import re
from collections.abc import Callable, Iterable

from robrain.protocol.wire.errors import CallError, ErrorCode
from robrain.protocol.wire.messages.tasks.task_messages import TaskRecord


class FreshIds:
    """Counts on, for each kind of task, from the largest number that the team has.

    Args:
        known: ids of the tasks of a kind that the coordinator knows.
        is_known: whether the coordinator knows a task of an id, of whatever kind.

    """

    def __init__(self, known: Callable[[str], Iterable[str]], is_known: Callable[[str], bool]) -> None:
        self._known = known
        self._is_known = is_known
        self._next: dict[str, int] = {}

    def submit(self, kind: str, submit: Callable[[str], TaskRecord], by: str) -> TaskRecord:
        """Submit a task under the next id that is free.

        Another client may take an id at the same moment: then it is refused, or, if that client has asked for the very
        same, its record is the answer, with its name.

        Args:
            kind: of the task.
            submit: submits the task under an id.
            by: who submits it.

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
