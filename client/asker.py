"""Queries to robots and the coordinator on worker threads: a slow one does not delay the caller's loop."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import zenoh

from robrain.protocol.errors import RobrainError
from robrain.protocol.topic import Q, Query, R
from robrain.protocol.wire.endpoint import Endpoint

WORKERS = 6
WAITING_MAX = 64
"""Further queries are refused: they come faster than robots answer."""
TIMEOUT_S = 5.0


A = TypeVar("A")
Then = Callable[[A | None, str], None]
"""Receives the reply of a query; or None, and the reason why there is none."""


class Asker:
    """Sends queries at once; `deliver` hands the answers over on its caller's thread.

    Args:
        endpoint: of the team; None for a recording, which cannot be asked: then queries are dropped.
        workers: how many are asked at a time.

    """

    def __init__(self, endpoint: Endpoint | None, *, workers: int = WORKERS) -> None:
        self._endpoint = endpoint
        self._pool = ThreadPoolExecutor(workers, thread_name_prefix="robrain-ask")
        self._answers: deque[tuple[Then[Any], Any, str]] = deque()
        self._waiting = 0

    def ask(
        self, topic: Query[Q, R], request: Q | None, then: Then[R], *, timeout_s: float = TIMEOUT_S, **names: str
    ) -> None:
        """Ask one key; `then` gets the answer. Called by the thread that delivers."""
        if (endpoint := self._endpoint) is not None:
            self.call(lambda: endpoint.ask(topic, request, timeout_s=timeout_s, **names), then)

    def call(self, function: Callable[[], A], then: Then[A]) -> None:
        """Call a function that asks; `then` gets its result. Called by the thread that delivers."""
        self._waiting += 1
        if self._waiting > WAITING_MAX:
            self._answers.append((then, None, "too many questions wait for an answer already; try again"))
            return

        def work() -> None:
            try:
                reply = function()
            except (RobrainError, zenoh.ZError) as error:
                self._answers.append((then, None, str(error)))
            else:
                self._answers.append((then, reply, "" if reply is not None else "an empty answer"))

        self._pool.submit(work)

    def deliver(self) -> None:
        """Hand over the answers that have arrived."""
        for _ in range(len(self._answers)):
            then, reply, error = self._answers.popleft()
            self._waiting -= 1
            then(reply, error)

    def close(self) -> None:
        """Send no more queries; returns when queries under way are answered or have timed out."""
        self._endpoint = None
        self._pool.shutdown(wait=True, cancel_futures=True)
