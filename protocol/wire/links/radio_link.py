"""The link of an endpoint in a lockstep run whose robots hear each other by radio, if at all."""

from threading import Event
from typing import Any

from robrain.protocol.wire.answers.asked import Answer
from robrain.protocol.wire.border.border import Heard
from robrain.protocol.wire.clock import Clock, to_ns
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.links.link import (
    Declaration,
    Replies,
    TakeAnswer,
    TakeChange,
    TakeQuery,
    TakeSample,
)
from robrain.protocol.wire.links.radio_exchange import RadioExchange
from robrain.protocol.wire.publisher import Publisher
from robrain.protocol.wire.topic import ANSWER_S, Topic, Urgency


class RadioLink:
    """A `Link` within this process, for one party.

    Args:
        exchange: of the run.
        party: whose endpoint it is: a robot's name, `COORDINATOR`, or `EVERYWHERE` for arena, recorder and scripts.

    Raises:
        ValueError: there is no such party.

    """

    def __init__(self, exchange: RadioExchange, party: str) -> None:
        self.declarations: list[Declaration] = []
        self._party = party
        self._exchange = exchange
        self._home = exchange.join(party)
        self._is_open = True

    def deliver(self, topic: Heard, key: str, payload: bytes) -> None:
        """Send a sample of this party."""
        self._exchange.deliver_from(self._party, topic, key, payload)

    def publisher(self, topic: Topic[Any], key: str, clock: Clock) -> Publisher:
        """See `Link`."""
        return Publisher(topic, key, clock, self)

    def subscribe(self, selector: str, topic: Topic[Any], inbox: Inbox, take: TakeSample, *, waits: bool) -> None:
        """See `Link`."""
        self.declarations.append(self._home.subscribe(selector, topic, inbox))

    def queryable(self, selector: str, take: TakeQuery, *, waits: bool) -> None:
        """See `Link`."""
        self.declarations.append(self._home.queryable(selector, take))

    def token(self, key: str) -> None:
        """See `Link`."""
        self.declarations.append(self._home.token(key))

    def watch(self, selector: str, take: TakeChange) -> None:
        """See `Link`."""
        self.declarations.append(self._home.watch(selector, take))

    def tokens(self, selector: str, timeout_s: float) -> list[str]:
        """See `Link`."""
        return self._home.tokens(selector)

    def ask(self, selector: str, payload: bytes | None, urgency: Urgency, timeout_s: float) -> Replies:
        """See `Link`; a query that is too late has failed at once."""
        answers: list[Answer] = []
        is_over = Event()
        query = self._exchange.ask_from(
            self._party, selector, payload or b"", to_ns(timeout_s), answers.append, is_over.set, waits=True
        )
        if not answers and query.is_late:
            return Replies((), in_time=False)
        in_time = bool(answers) or is_over.wait(timeout_s)
        return Replies(answers, in_time, from_outside=not in_time)

    def ask_then(self, key: str, payload: bytes | None, take: TakeAnswer) -> None:
        """See `Link`."""
        self._exchange.ask_from(self._party, key, payload or b"", to_ns(ANSWER_S), take, lambda: None, waits=False)

    def close(self) -> None:
        """See `Link`."""
        while self.declarations:
            self.declarations.pop().undeclare()
        if self._is_open:
            self._is_open = False
            self._exchange.leave(self._home)
