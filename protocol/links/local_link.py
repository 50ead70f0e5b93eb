"""The link of an endpoint in a lockstep run that no other process can join."""

from functools import partial
from threading import Event
from typing import Any

from robrain.protocol.answers.asked import Answer
from robrain.protocol.clock import Clock, to_ns
from robrain.protocol.links.exchange import EVERYWHERE, Exchange
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.links.link import Declaration, OnAnswer, OnChange, OnQuery, OnSample, Replies
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.topic import ANSWER_S, Topic, Urgency


class LocalLink:
    """A `Link` to the other endpoints of this process; nothing is declared to Zenoh.

    Args:
        exchange: of the run.
        party: of the endpoint: a robot's name, `COORDINATOR`, or `EVERYWHERE` for arena, recorder and scripts.

    Raises:
        ValueError: there is no such party.

    """

    def __init__(self, exchange: Exchange, party: str = EVERYWHERE) -> None:
        self.declarations: list[Declaration] = []
        self._exchange = exchange
        self._party = exchange.join(party)
        self._is_open = True

    def publisher(self, topic: Topic[Any], key: str, clock: Clock) -> Publisher:
        """See `Link`."""
        return Publisher(topic, key, clock, partial(self._exchange.deliver, self._party))

    def subscribe(self, selector: str, topic: Topic[Any], inbox: Inbox, handle: OnSample, *, waits: bool) -> None:
        """See `Link`."""
        self.declarations.append(self._exchange.subscribe(selector, topic, inbox, self._party))

    def queryable(self, selector: str, handle: OnQuery, *, waits: bool) -> None:
        """See `Link`."""
        self.declarations.append(self._exchange.queryable(selector, handle, self._party))

    def token(self, key: str) -> None:
        """See `Link`."""
        self.declarations.append(self._exchange.token(key, self._party))

    def watch(self, selector: str, handle: OnChange) -> None:
        """See `Link`."""
        self.declarations.append(self._exchange.watch(selector, handle, self._party))

    def tokens(self, selector: str, timeout_s: float) -> list[str]:
        """See `Link`."""
        return self._exchange.tokens(selector, self._party)

    def ask(self, selector: str, payload: bytes | None, urgency: Urgency, timeout_s: float) -> Replies:
        """See `Link`; a query that is too late has failed at once."""
        answers: list[Answer] = []
        is_over = Event()
        limit_ns = to_ns(timeout_s)
        is_in_time = self._exchange.ask(
            self._party, selector, payload or b"", limit_ns, answers.append, is_over.set, waits=True
        )
        if not answers and not is_in_time:
            return Replies((), in_time=False)
        in_time = bool(answers) or is_over.wait(timeout_s)
        return Replies(answers, in_time, from_outside=not in_time)

    def ask_then(self, key: str, payload: bytes | None, handle: OnAnswer) -> None:
        """See `Link`."""
        self._exchange.ask(self._party, key, payload or b"", to_ns(ANSWER_S), handle, lambda: None, waits=False)

    def close(self) -> None:
        """See `Link`."""
        while self.declarations:
            self.declarations.pop().undeclare()
        if self._is_open:
            self._is_open = False
            self._exchange.leave(self._party)
