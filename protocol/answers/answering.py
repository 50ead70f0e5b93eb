"""Answering on several threads, which take queries off Zenoh's own channel, or off a queue that several queries share.

To hand a query on by a queue costs 25 µs, a channel of its own two threads more.
"""

import threading
import time
from collections.abc import Callable
from queue import SimpleQueue
from typing import Generic, TypeVar

STANDING_BY = 2
"""Threads to begin with: one that answers, one that waits for the next query."""

AskedT = TypeVar("AskedT")


class Answering(Generic[AskedT]):
    """Threads that answer queries, in the live drive only.

    There is always one that waits: queries are taken even when all others are stuck in their answers.
    It grows with need up to a limit; from there on what comes is refused, and nothing holds up Zenoh's own threads.

    Args:
        name: of the threads.
        receive: waits for a query; None when there will be no more.
        answer: answers a query.
        refuse: tells that nobody is free.
        limit: how many may be answered at a time.
        standing_by: threads to begin with.

    """

    def __init__(
        self,
        name: str,
        receive: Callable[[], AskedT | None],
        answer: Callable[[AskedT], None],
        refuse: Callable[[AskedT], None],
        limit: int,
        standing_by: int = STANDING_BY,
    ) -> None:
        self._name = name
        self._receive = receive
        self._answer = answer
        self._refuse = refuse
        self._limit = limit
        self._counting = threading.Lock()
        self._free = 0
        self._threads: list[threading.Thread] = []
        with self._counting:
            for _ in range(min(standing_by, limit + 1)):
                self._begin()

    @property
    def threads(self) -> int:
        """How many there are."""
        return len(self._threads)

    def join(self, timeout_s: float) -> list[str]:
        """Wait for the threads to end, after `receive` has nothing more.

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
        while (asked := self._receive()) is not None:
            with counting:
                self._free -= 1
                if self._free == 0 and len(self._threads) <= self._limit:
                    self._begin()
                do = self._answer if self._free else self._refuse
            do(asked)
            with counting:
                self._free += 1


class SharedQueue(Generic[AskedT]):
    """Queries that wait for the threads of one `Answering`."""

    def __init__(self) -> None:
        self._asked: SimpleQueue[AskedT | None] = SimpleQueue()

    def put(self, asked: AskedT) -> None:
        """Have a query answered or refused; waits for nothing."""
        self._asked.put(asked)

    def receive(self) -> AskedT | None:
        """Wait for a query; None after `end`."""
        asked = self._asked.get()
        if asked is None:
            self._asked.put(None)  # for the next thread
        return asked

    def end(self) -> None:
        """Nothing more is put."""
        self._asked.put(None)

    @property
    def waiting(self) -> int:
        """How many queries no thread has taken yet."""
        return self._asked.qsize()
