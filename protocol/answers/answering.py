"""Answering on several threads, which take queries off Zenoh's own channel, or off a queue that several queries share.

A handover of a query by a queue costs 25 µs, a separate channel two threads more.
"""

import logging
import threading
from collections import Counter, deque
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, Generic, TypeVar

import zenoh

from robrain.protocol.answers.asked import Asked
from robrain.protocol.errors import CallError
from robrain.protocol.topic import Query
from robrain.protocol.workers import OwnedThread, close_threads

READY = 2
"""Threads to begin with: one that answers, one that waits for the next query."""

AskedT = TypeVar("AskedT")


class Answering(Generic[AskedT]):
    """Threads that answer queries, in the live drive only.

    There is always one that waits: queries are taken even when all others are stuck in their answers.
    It grows with need up to a limit. Beyond the limit queries are refused, and Zenoh's own threads never block.

    Args:
        name: the threads' name.
        receive: waits for a query; None when there will be no more.
        answer: answers a query.
        refuse: reports that no thread is free.
        limit: how many may be answered at a time.
        ready: threads to begin with.

    """

    def __init__(
        self,
        name: str,
        receive: Callable[[], AskedT | None],
        answer: Callable[[AskedT], None],
        refuse: Callable[[AskedT], None],
        limit: int,
        ready: int = READY,
    ) -> None:
        self._name = name
        self._receive = receive
        self._answer = answer
        self._refuse = refuse
        self._limit = limit
        self._counting = threading.Lock()
        self._free = 0
        self._threads: list[OwnedThread] = []
        with self._counting:
            for _ in range(min(ready, limit + 1)):
                self._begin()

    @property
    def threads(self) -> int:
        """How many there are."""
        return len(self._threads)

    def close(self, timeout_s: float) -> None:
        """Wait for the threads to end, after `receive` has nothing more. Threads that do not end are reported."""
        close_threads(self._threads, timeout_s)

    def _begin(self) -> None:
        self._free += 1
        self._threads.append(OwnedThread(f"{self._name}-{len(self._threads) + 1}", self._work))

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


T = TypeVar("T")


class WaitingQueries(Generic[T]):
    """A queue in which the busiest client cannot displace the others. Any thread may call it.

    Args:
        most: of queries.

    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._lock = threading.Lock()
        self._waiting: deque[tuple[str, T]] = deque()
        self._of: Counter[str] = Counter()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, asker: str, query: T) -> T | None:
        """Let a query wait.

        Args:
            asker: name of the client; empty for all clients without a name.
            query: the query.

        Returns:
            The query to refuse if there is no room: the last of the client with more waiting, or this one.

        """
        refused = None
        with self._lock:
            if len(self._waiting) >= self._most:
                greedy, most = max(self._of.items(), key=lambda one: (one[1], one[0]))
                if most <= self._of[asker] + 1:
                    return query
                place = next(at for at in range(len(self._waiting) - 1, -1, -1) if self._waiting[at][0] == greedy)
                refused = self._waiting[place][1]
                del self._waiting[place]
                self._forget(greedy)
            self._waiting.append((asker, query))
            self._of[asker] += 1
        return refused

    def pop(self) -> T | None:
        """The one that has waited longest; None if there is none."""
        with self._lock:
            if not self._waiting:
                return None
            asker, query = self._waiting.popleft()
            self._forget(asker)
        return query

    def _forget(self, asker: str) -> None:
        self._of[asker] -= 1
        if not self._of[asker]:
            del self._of[asker]


logger = logging.getLogger(__name__)


def reply_deferred(query: Asked, key: str, topic: Query[Any, Any], reply: object) -> None:
    """Send a reply or a CallError, and end the query; nothing is sent if the session has closed."""
    try:
        if isinstance(reply, CallError):
            query.reply_error(reply)
        else:
            query.reply(key, topic.payloads.write(reply), topic.encoding)
    except zenoh.ZError as closed:
        logger.debug("%s: no reply can be sent any more: %s", key, closed)
    finally:
        query.end()
