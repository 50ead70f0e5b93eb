"""The trace of a task: one number for all that processes do for it, carried by queries in Zenoh's attachment.

It is the trace id of W3C Trace Context, 32 hexadecimal digits. A program that has a trace submits a task with that
trace. Any other task has a trace that follows from its id, so that every process can compute it.
"""

import hashlib
import re
import threading

TRACE_DIGITS = 32
KEPT = 4096
"""Traces of other programs that are kept; the oldest are forgotten, and their tasks have their own again."""
_TRACE = re.compile(rf"(?!0+$)[0-9a-f]{{{TRACE_DIGITS}}}")


def trace_of(team: str, task: str) -> str:
    """The trace of a task that was given no other.

    >>> trace_of("default", "visit-1") == trace_of("default", "visit-1") != trace_of("other", "visit-1")
    True
    """
    return hashlib.sha256(f"{team}/{task}".encode()).hexdigest()[:TRACE_DIGITS]


def read_trace(attachment: bytes) -> str:
    """The trace in an attachment; empty if it is none.

    >>> read_trace(b"4bf92f3577b34da6a3ce929d0e0e4736"), read_trace(b"../x"), read_trace(b"0" * 32)
    ('4bf92f3577b34da6a3ce929d0e0e4736', '', '')
    """
    if len(attachment) != TRACE_DIGITS:
        return ""
    text = attachment.decode("ascii", errors="replace")
    return text if _TRACE.fullmatch(text) else ""


class Traces:
    """The traces of tasks, as one component knows them. Any thread may use it.

    Args:
        team: of the tasks.

    """

    def __init__(self, team: str) -> None:
        self._team = team
        self._given: dict[str, str] = {}
        self._lock = threading.Lock()

    def record(self, task: str, trace: str) -> None:
        """Take the trace that a query about a task came with; an empty one changes nothing."""
        if not trace or trace == trace_of(self._team, task):
            return
        with self._lock:
            self._given.pop(task, None)
            self._given[task] = trace
            if len(self._given) > KEPT:
                del self._given[next(iter(self._given))]

    def of(self, task: str) -> str:
        """The trace of a task."""
        return self._given.get(task) or trace_of(self._team, task)
