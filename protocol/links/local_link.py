"""The link of an endpoint in a lockstep run that no other process can join."""

from threading import Event
from typing import Any

from robrain.protocol.answers.asked import Answer
from robrain.protocol.clock import Clock
from robrain.protocol.links.exchange import Exchange
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.links.link import Declaration, Replies, TakeAnswer, TakeChange, TakeQuery, TakeSample
from robrain.protocol.links.party_exchange import PartyExchange
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.table.topic import Topic, Urgency


class DeclaringLink:
    """What all links within this process have in common; nothing is declared to Zenoh."""

    def __init__(self, home: Exchange | PartyExchange) -> None:
        self.declarations: list[Declaration] = []
        self._declared_at = home

    def subscribe(self, selector: str, topic: Topic[Any], inbox: Inbox, take: TakeSample, *, waits: bool) -> None:
        """See `Link`."""
        self.declarations.append(self._declared_at.subscribe(selector, topic, inbox))

    def queryable(self, selector: str, take: TakeQuery, *, waits: bool) -> None:
        """See `Link`."""
        self.declarations.append(self._declared_at.queryable(selector, take))

    def token(self, key: str) -> None:
        """See `Link`."""
        self.declarations.append(self._declared_at.token(key))

    def watch(self, selector: str, take: TakeChange) -> None:
        """See `Link`."""
        self.declarations.append(self._declared_at.watch(selector, take))

    def tokens(self, selector: str, timeout_s: float) -> list[str]:
        """See `Link`."""
        return self._declared_at.tokens(selector)

    def close(self) -> None:
        """See `Link`."""
        while self.declarations:
            self.declarations.pop().undeclare()


class LocalLink(DeclaringLink):
    """A `Link` to all other endpoints of this process.

    Args:
        exchange: of the run.

    """

    def __init__(self, exchange: Exchange) -> None:
        super().__init__(exchange)
        self._exchange = exchange

    def publisher(self, topic: Topic[Any], key: str, clock: Clock) -> Publisher:
        """See `Link`."""
        return Publisher(topic, key, clock, self._exchange)

    def ask(self, selector: str, payload: bytes | None, urgency: Urgency, timeout_s: float) -> Replies:
        """See `Link`."""
        answers: list[Answer] = []
        is_over = Event()
        self._exchange.ask(selector, payload or b"", answers.append, is_over.set)
        in_time = bool(answers) or is_over.wait(timeout_s)
        return Replies(answers, in_time, from_outside=not in_time)

    def ask_then(self, key: str, payload: bytes | None, take: TakeAnswer) -> None:
        """See `Link`."""
        self._exchange.ask(key, payload or b"", take, lambda: None)
