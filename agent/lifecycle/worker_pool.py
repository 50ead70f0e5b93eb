"""A pool of threads that make foreign calls in parallel, so that one that hangs holds up no other.

Of the live drive only, as are its waits by the wall's clock; in lockstep the same calls go by `run_in_turn`.
"""

import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from queue import Empty, SimpleQueue

from robrain.agent.errors import FOREIGN_ERRORS
from robrain.protocol.workers import OwnedThread, close_threads

Call = Callable[[], object]

STALL_S = 0.002
"""If none of several calls has returned for this time, those that still wait get separate threads."""


class NotBack(TimeoutError):
    """A call has not come back in time; it continues by itself."""


class WorkerPool:
    """Makes calls on threads that are there already: to start one takes time while a plugin keeps Python busy.

    Args:
        name: the threads' name.
        limit_s: time limit of a call, unless another is given; one that takes longer continues by itself.
        idle_s: a thread that has been idle for this long ends; None keeps all.

    """

    def __init__(self, name: str, limit_s: float, *, idle_s: float | None = None) -> None:
        self._name = name
        self._idle_s = idle_s
        self._limit_s = limit_s
        self._jobs: SimpleQueue[Call | None] = SimpleQueue()
        self._counting = threading.Lock()
        self._free = self._begun = 0
        """Threads without a call; below 0, calls without a thread."""
        self._threads: list[OwnedThread] = []

    def stand_by(self, count: int) -> None:
        """Have at least `count` free threads."""
        with self._counting:
            self._start(count - self._free)

    def run(self, calls: Mapping[str, Call], limit_s: float | None = None) -> dict[str, BaseException]:
        """Make calls in parallel, and wait for them up to the limit.

        Returns:
            The errors of those that failed; NotBack for those that have not come back.

        """
        limit_s = self._limit_s if limit_s is None else limit_s
        ended: SimpleQueue[tuple[str, BaseException | None]] = SimpleQueue()
        failed: dict[str, BaseException] = {}
        running: dict[str, None] = {}
        for name, call in calls.items():
            self._put(partial(_report, ended, name, call), at_once=not running)
            running[name] = None
        deadline_s = time.monotonic() + limit_s
        while running:
            left_s = max(deadline_s - time.monotonic(), 0.0)
            try:
                name, error = ended.get(timeout=min(left_s, STALL_S) if self._jobs.qsize() else left_s)
            except Empty:
                if left_s <= 0.0:
                    break
                with self._counting:  # the existing threads are stuck: waiting calls get separate threads
                    self._start(-self._free)
                continue
            del running[name]
            if error is not None:
                failed[name] = error
        return failed | {name: NotBack(f"it has not come back for {limit_s:g} s") for name in running}

    def begin(self, call: Call) -> None:
        """Make a call, and do not wait for it."""
        self._put(call, at_once=True)

    def close(self) -> None:
        """End the threads; those that hang are abandoned."""
        for _ in self._threads:
            self._jobs.put(None)
        close_threads(self._threads, self._limit_s)

    def _put(self, call: Call, *, at_once: bool) -> None:
        with self._counting:
            if at_once:
                self._start(1 - self._free)
            self._free -= 1
            self._jobs.put(call)

    def _start(self, count: int) -> None:
        for _ in range(count):
            self._free += 1
            self._begun += 1
            thread = OwnedThread(f"{self._name}-{self._begun}", self._work)
            self._threads = [*(each for each in self._threads if each.is_alive), thread]

    def _work(self) -> None:
        while (call := self._next()) is not None:
            _outcome(call)
            with self._counting:
                self._free += 1

    def _next(self) -> Call | None:
        """The next call; None if this thread is to end."""
        while True:
            try:
                return self._jobs.get(timeout=self._idle_s)
            except Empty:
                with self._counting:
                    if self._free > self._jobs.qsize():  # no caller waits for this one
                        self._free -= 1
                        return None


def run_in_turn(calls: Mapping[str, Call]) -> dict[str, BaseException]:
    """Make calls one after another, on this thread; returns the errors of those that failed."""
    outcomes = {name: _outcome(call) for name, call in calls.items()}
    return {name: error for name, error in outcomes.items() if error is not None}


def _report(ended: SimpleQueue[tuple[str, BaseException | None]], name: str, call: Call) -> None:
    ended.put((name, _outcome(call)))


def _outcome(call: Call) -> BaseException | None:
    try:
        call()
    except FOREIGN_ERRORS as error:  # foreign plugin code; it must not keep the others from being called
        return error
    return None
