"""Asks robots and the coordinator on threads of its own, so that a slow one holds up neither drawing nor the halt."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Generic

import zenoh

from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.errors import RobrainError
from robrain.protocol.wire.topic import Q, Query, R

WORKERS = 6
WAITING_MAX = 64
"""More questions than this are refused: somebody clicks faster than robots answer."""
TIMEOUT_S = 5.0


@dataclass(frozen=True)
class Answer(Generic[R]):
    """What came of a question: a reply, or in words why there is none."""

    known: R | None = None
    error: str = ""

    @property
    def reply(self) -> R:
        """The reply.

        Raises:
            ValueError: there is none; the text says why.

        """
        if self.error or self.known is None:
            raise ValueError(self.error or "an empty answer")
        return self.known


Then = Callable[[Answer[R]], None]


class Asker:
    """Questions go out at once; what comes back is handed over in `deliver`, on its caller's thread."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._pool = ThreadPoolExecutor(WORKERS, thread_name_prefix="robrain-ask")
        self._answers: deque[tuple[Then[Any], Answer[Any]]] = deque()
        self._waiting = 0
        self._closed = False

    def ask(
        self,
        topic: Query[Q, R],
        request: Q | None,
        then: Then[R],
        *,
        timeout_s: float = TIMEOUT_S,
        by: str = "",
        **names: str,
    ) -> None:
        """Ask one key; `then` is told the answer, or why there is none. Called by the thread that delivers."""
        if self._closed:
            return
        if self._waiting >= WAITING_MAX:
            self._answers.append((then, Answer(error="too many questions wait for an answer already; try again")))
            return
        self._waiting += 1

        def work() -> None:
            try:
                answer = Answer(self._endpoint.ask(topic, request, timeout_s=timeout_s, by=by, **names))
            except (RobrainError, zenoh.ZError) as error:
                answer = Answer(error=str(error))
            self._answers.append((self._done(then), answer))

        self._pool.submit(work)

    def deliver(self) -> None:
        """Hand over what has been answered."""
        for _ in range(len(self._answers)):
            then, answer = self._answers.popleft()
            then(answer)

    def close(self) -> None:
        """Ask no more; returns when those under way are answered or have timed out."""
        self._closed = True
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _done(self, then: Then[R]) -> Then[R]:
        def handed_over(answer: Answer[R]) -> None:
            self._waiting -= 1
            then(answer)

        return handed_over
