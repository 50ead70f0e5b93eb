"""Queries to robots and the coordinator on worker threads: a slow one delays neither the drawing nor the halt."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Generic

import zenoh

from robrain.protocol.errors import RobrainError
from robrain.protocol.table.topic import Q, Query, R
from robrain.protocol.wire.endpoint import Endpoint

WORKERS = 6
WAITING_MAX = 64
"""Further queries are refused: they come faster than robots answer."""
TIMEOUT_S = 5.0


@dataclass(frozen=True)
class QueryOutcome(Generic[R]):
    """The outcome of a query: a reply, or the reason why there is none."""

    known: R | None = None
    error: str = ""

    @property
    def reply(self) -> R:
        """The reply.

        Raises:
            ValueError: there is none; the text gives the reason.

        """
        if self.error or self.known is None:
            raise ValueError(self.error or "an empty answer")
        return self.known


Then = Callable[[QueryOutcome[R]], None]


class Asker:
    """Sends queries at once; `deliver` hands the answers over on its caller's thread.

    Args:
        endpoint: of the team; None for a recording, which cannot be asked: then queries are dropped.

    """

    def __init__(self, endpoint: Endpoint | None) -> None:
        self._endpoint = endpoint
        self._pool = ThreadPoolExecutor(WORKERS, thread_name_prefix="robrain-ask")
        self._answers: deque[tuple[Then[Any], QueryOutcome[Any]]] = deque()
        self._waiting = 0

    def ask(
        self, topic: Query[Q, R], request: Q | None, then: Then[R], *, timeout_s: float = TIMEOUT_S, **names: str
    ) -> None:
        """Ask one key; `then` gets the answer. Called by the thread that delivers."""
        endpoint = self._endpoint
        if endpoint is None:
            return
        self._waiting += 1
        if self._waiting > WAITING_MAX:
            self._answers.append((then, QueryOutcome(error="too many questions wait for an answer already; try again")))
            return

        def work() -> None:
            try:
                answer = QueryOutcome(endpoint.ask(topic, request, timeout_s=timeout_s, **names))
            except (RobrainError, zenoh.ZError) as error:
                answer = QueryOutcome(error=str(error))
            self._answers.append((then, answer))

        self._pool.submit(work)

    def deliver(self) -> None:
        """Hand over the answers that have arrived."""
        for _ in range(len(self._answers)):
            then, answer = self._answers.popleft()
            self._waiting -= 1
            then(answer)

    def close(self) -> None:
        """Send no more queries; returns when queries under way are answered or have timed out."""
        self._endpoint = None
        self._pool.shutdown(wait=True, cancel_futures=True)
