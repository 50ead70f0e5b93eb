"""Queries that wait for a component's step: bounded, and shared out among those who ask."""

import threading
from collections import Counter, deque
from typing import Generic, TypeVar

T = TypeVar("T")


class WaitingQueries(Generic[T]):
    """A queue that whoever asks most cannot keep others out of. Any thread may call it.

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
        """Let a query wait; the one to refuse if there is no room: the last of whoever has more waiting, or this one.

        Args:
            asker: who asks; empty for all of whom that is not known.
            query: what is asked.

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

    def take(self) -> T | None:
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
