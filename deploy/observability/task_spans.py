"""The spans of tasks: a task from its submission to its end, and in it each state in which it was, and where."""

import hashlib
from collections import OrderedDict
from typing import NamedTuple

from robrain.protocol.wire.messages.tasks.offer_messages import TaskEvent

OPEN_MAX = 10_000
"""Tasks that are followed at a time; of more, the longest known are left out."""


class TaskSpan(NamedTuple):
    """A part of a trace that has ended."""

    name: str
    trace: str
    """32 hexadecimal digits."""
    span: str
    """16 hexadecimal digits; equal after a restart of `robrain traces`."""
    parent: str
    """That of the whole task; empty for itself."""
    start_ns: int
    end_ns: int
    attributes: dict[str, str | int | float]
    error: str = ""
    """Why the task failed; empty if it did not."""


class _Open(NamedTuple):
    trace: str
    start_ns: int
    last: TaskEvent


class TaskSpans:
    """Makes spans from the changes of a team's tasks, in the order of the journal."""

    def __init__(self) -> None:
        self.left_out = 0
        """Tasks that were left out as there were too many at a time."""
        self._open: OrderedDict[str, _Open] = OrderedDict()

    def knows(self, task: str) -> bool:
        """Whether a task is being followed, so that its trace is known."""
        return task in self._open

    def take(self, event: TaskEvent, trace: str) -> list[TaskSpan]:
        """The spans that end with a change.

        Args:
            event: the change; one that came before is passed over.
            trace: of the task; counts with the first change that is taken.

        """
        task, before = event.task.id, self._open.get(event.task.id)
        if before is None:
            if not event.state.ended:  # of a task that is first heard of at its end there is nothing to tell
                self._open[task] = _Open(trace, event.stamp_ns, event)
                if len(self._open) > OPEN_MAX:
                    self._open.popitem(last=False)
                    self.left_out += 1
            return []
        if event.change <= before.last.change:
            return []
        ended = [_of_state(before, event)]
        if event.state.ended:
            del self._open[task]
            return [*ended, _of_task(before, event)]
        self._open[task] = before._replace(last=event)
        return ended


def _of_state(before: _Open, event: TaskEvent) -> TaskSpan:
    last = before.last
    at = f" at {last.robot}" if last.robot else ""
    return TaskSpan(
        name=f"{last.state.replace('_', ' ')}{at}",
        trace=before.trace,
        span=_span_id(before.trace, str(last.change)),
        parent=_span_id(before.trace, ""),
        start_ns=last.stamp_ns,
        end_ns=max(last.stamp_ns, event.stamp_ns),
        attributes=_attributes(last) | {"robrain.then": event.state.value},
    )


def _of_task(before: _Open, event: TaskEvent) -> TaskSpan:
    results = {f"robrain.result.{name}": value for name, value in event.result.items() if _is_plain(value)}
    return TaskSpan(
        name=f"task {event.task.kind}",
        trace=before.trace,
        span=_span_id(before.trace, ""),
        parent="",
        start_ns=before.start_ns,
        end_ns=max(before.start_ns, event.stamp_ns),
        attributes=_attributes(event) | results,
        error=(event.why or "failed") if event.state.value == "failed" else "",
    )


def _attributes(event: TaskEvent) -> dict[str, str | int | float]:
    found: dict[str, str | int | float] = {
        "robrain.task": event.task.id,
        "robrain.kind": event.task.kind,
        "robrain.state": event.state.value,
        "robrain.robot": event.robot,
        "robrain.epoch": event.epoch,
        "robrain.why": event.why,
    }
    return {name: value for name, value in found.items() if value not in ("", 0)}


def _is_plain(value: object) -> bool:
    return isinstance(value, (str, int, float))


def _span_id(trace: str, part: str) -> str:
    return hashlib.sha256(f"{trace}/{part}".encode()).hexdigest()[:16]
