"""A pool of threads that make foreign calls side by side, so that one that hangs holds up no other.

Of the live drive only, as are its waits by the wall's clock; in lockstep the same calls go by `run_in_turn`.
"""

import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from queue import Empty, SimpleQueue

from robrain.agent.errors import FOREIGN_ERRORS

Call = Callable[[], object]


class NotBack(TimeoutError):
    """A call has not come back in time; it goes on by itself."""


class WorkerPool:
    """Makes calls on threads that are there already: to start one takes time while a plugin keeps Python busy.

    Args:
        name: of the threads.
        limit_s: how long a call is waited for, unless told otherwise; one that takes longer goes on by itself.

    """

    def __init__(self, name: str, limit_s: float) -> None:
        self._name = name
        self._limit_s = limit_s
        self._jobs: SimpleQueue[Call | None] = SimpleQueue()
        self._counting = threading.Lock()
        self._free = 0
        self._threads: list[threading.Thread] = []

    def stand_by(self, count: int) -> None:
        """Have at least so many threads that are free."""
        with self._counting:
            missing = count - self._free
            self._free = max(count, self._free)
        for _ in range(missing):
            thread = threading.Thread(target=self._work, name=f"{self._name}-{len(self._threads) + 1}", daemon=True)
            self._threads.append(thread)
            thread.start()

    def run(self, calls: Mapping[str, Call], limit_s: float | None = None) -> dict[str, BaseException]:
        """Make calls side by side, and wait for them as long as the limit says.

        Returns:
            What those raised that failed; NotBack for those that have not come back.

        """
        limit_s = self._limit_s if limit_s is None else limit_s
        ended: SimpleQueue[tuple[str, BaseException | None]] = SimpleQueue()
        for name, call in calls.items():
            self.begin(partial(_report, ended, name, call))
        failed: dict[str, BaseException] = {}
        running = dict.fromkeys(calls)
        deadline_s = time.monotonic() + limit_s
        while running:
            try:
                name, error = ended.get(timeout=max(deadline_s - time.monotonic(), 0.0))
            except Empty:
                break
            del running[name]
            if error is not None:
                failed[name] = error
        return failed | {name: NotBack(f"it has not come back for {limit_s:g} s") for name in running}

    def begin(self, call: Call) -> None:
        """Make a call, and do not wait for it."""
        self.stand_by(1)
        with self._counting:
            self._free -= 1
        self._jobs.put(call)

    def close(self) -> None:
        """End the threads; those that hang are abandoned."""
        for _ in self._threads:
            self._jobs.put(None)
        deadline_s = time.monotonic() + self._limit_s
        for thread in self._threads:
            thread.join(max(deadline_s - time.monotonic(), 0.0))

    def _work(self) -> None:
        while (call := self._jobs.get()) is not None:
            _outcome(call)
            with self._counting:
                self._free += 1


def run_in_turn(calls: Mapping[str, Call]) -> dict[str, BaseException]:
    """Make calls one after the other, on this thread; what those raised that failed."""
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
