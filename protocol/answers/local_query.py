"""Queries within a process: requests, and the replies as Zenoh would deliver them.

Zenoh delivers errors at once. Other replies wait until all answering endpoints have ended their query; of those to one
key the last one counts.
"""

from collections.abc import Callable
from threading import Lock
from typing import ClassVar

import msgspec
import zenoh

from robrain.protocol.answers.asked import BY, Answer
from robrain.protocol.errors import CallError


class Gathering:
    """The replies to one query, from all answering endpoints.

    Args:
        selector: key expression that is asked, with its parameters.
        payload: the request.
        number: how many are asked.
        handle: gets each reply.
        over: called when there will be no more.

    """

    _counting: ClassVar[Lock] = Lock()
    """Replies may be sent by any thread."""

    def __init__(
        self, selector: str, payload: bytes, number: int, handle: Callable[[Answer], None], over: Callable[[], None]
    ) -> None:
        self.selector = selector
        self.key = selector.partition("?")[0]
        self.payload = payload
        self.handle = handle
        self._waits_for = number
        self._over = over
        self._replies: dict[str, bytes] = {}
        if not number:
            over()

    def reply(self, key: str, payload: bytes) -> None:
        """Take a reply in."""
        if key != self.key and not zenoh.KeyExpr(self.key).intersects(zenoh.KeyExpr(key)):
            raise zenoh.ZError(f"a reply on {key} to a query of {self.key}")
        self._replies[key] = payload

    def one_ended(self) -> None:
        """An answering endpoint sends no more."""
        with self._counting:
            self._waits_for -= 1
            if self._waits_for:
                return
        for key, payload in self._replies.items():
            self.handle(Answer(key, payload))
        self._over()


class LocalQuery:
    """One query for one answering endpoint; an `Asked`."""

    __slots__ = ("_gathering", "_is_over")

    def __init__(self, gathering: Gathering) -> None:
        self._gathering = gathering
        self._is_over = False

    @property
    def key(self) -> str:
        """See `Asked`."""
        return self._gathering.key

    @property
    def selector(self) -> str:
        """See `Asked`."""
        return self._gathering.selector

    @property
    def by(self) -> str:
        """See `Asked`."""
        parameters = self._gathering.selector.partition("?")[2]
        return zenoh.Parameters(parameters).get(BY) or "" if parameters else ""

    @property
    def payload(self) -> bytes:
        """See `Asked`."""
        return self._gathering.payload

    def reply(self, key: str, payload: bytes, encoding: str) -> None:
        """See `Asked`; both ends know the encoding by the query's row."""
        self._gathering.reply(key, payload)

    def reply_error(self, error: CallError) -> None:
        """See `Asked`."""
        self._gathering.handle(Answer("", msgspec.json.encode(error.reply()), is_error=True))

    def end(self) -> None:
        """See `Asked`."""
        if not self._is_over:
            self._is_over = True
            self._gathering.one_ended()

    def __del__(self) -> None:
        self.end()
