"""Answering on several threads: each takes its query off Zenoh's own channel; none is handed on."""

import threading
import time
from collections.abc import Callable

import zenoh

STANDING_BY = 2
"""Threads to begin with: one that answers, one that waits for the next query."""

Do = Callable[[zenoh.Query], None]


class Answering:
    """Threads that answer the queries of one queryable, in the live drive only.

    There is always one that waits: queries are taken off the channel even when all others are stuck in their answers.
    It grows with need up to a limit; from there on what comes is refused, and nothing holds up Zenoh's own threads.

    Args:
        name: of the threads.
        receive: waits for a query; raises ZError when there will be no more.
        answer: answers one.
        refuse: tells that nobody is free.
        limit: how many may be answered at a time.

    """

    def __init__(self, name: str, receive: Callable[[], zenoh.Query], answer: Do, refuse: Do, limit: int) -> None:
        self._name = name
        self._receive = receive
        self._answer = answer
        self._refuse = refuse
        self._limit = limit
        self._counting = threading.Lock()
        self._free = 0
        self._threads: list[threading.Thread] = []
        with self._counting:
            for _ in range(min(STANDING_BY, limit + 1)):
                self._begin()

    @property
    def threads(self) -> int:
        """How many there are."""
        return len(self._threads)

    def join(self, timeout_s: float) -> list[str]:
        """Wait for the threads to end, after the queryable was undeclared.

        Returns:
            The names of those that are stuck; they are daemons and are left behind.

        """
        deadline_s = time.monotonic() + timeout_s
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(max(deadline_s - time.monotonic(), 0.0))
        return [thread.name for thread in self._threads if thread.is_alive()]

    def _begin(self) -> None:
        self._free += 1
        thread = threading.Thread(target=self._work, name=f"{self._name}-{len(self._threads) + 1}", daemon=True)
        self._threads.append(thread)
        thread.start()

    def _work(self) -> None:
        counting = self._counting
        while True:
            try:
                query = self._receive()
            except zenoh.ZError:  # undeclared, and nothing waits any more
                return
            with counting:
                self._free -= 1
                if self._free == 0 and len(self._threads) <= self._limit:
                    self._begin()
                do = self._answer if self._free else self._refuse
            do(query)
            with counting:
                self._free += 1
