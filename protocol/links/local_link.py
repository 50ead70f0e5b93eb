"""The link of an endpoint in a lockstep run that no other process can join."""

from collections.abc import Callable
from threading import Event
from typing import Any

import zenoh

from robrain.protocol.answers.asked import Answer, Asked
from robrain.protocol.border.border import Heard
from robrain.protocol.clock import Clock
from robrain.protocol.links.exchange import NOBODY, Exchange, is_wild
from robrain.protocol.links.inbox import Inbox, Sample
from robrain.protocol.links.link import Declaration, Replies, TakeAnswer, TakeChange, TakeQuery, TakeSample
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.table.topic import Topic, Urgency


class PartyExchange(Exchange):
    """Declarations of the endpoints of one party, and the tokens that they see.

    Args:
        party: owner.
        changed: called when other samples are taken than before.
        token_changed: called with the key of a token of this party that has come or gone.

    """

    def __init__(self, party: str, changed: Callable[[], None], token_changed: Callable[[str], None]) -> None:
        self.party = party
        self.links = 0
        """Endpoints that are open."""
        self.seen: dict[str, None] = {}
        """Keys of the tokens that the party sees, in the order in which they came."""
        self._changed = changed
        self._on_token = token_changed
        super().__init__(is_alone=True)

    @property
    def own_tokens(self) -> set[str]:
        """Keys of the party's own tokens."""
        return self._present

    def takes(self, topic: Heard, key: str) -> bool:
        """Whether any inbox takes a key."""
        route = self.routes.get(key) or self._route(topic, key)
        return route is not NOBODY

    def hand(self, sample: Sample) -> None:
        """Give a sample, which other parties may get as well, to all inboxes that take its key."""
        topic, key, payload, _ = sample
        route = self.routes.get(key)
        if route is None or (route is not NOBODY and route.topic is not topic):
            route = self._route(topic, key)
        if route.plain:
            Inbox.put_into(route.plain, sample)
        for inbox in route.special:
            inbox.take(sample)
        for subscription in route.others:
            subscription.inbox.append(subscription.topic, key, payload)

    def answerers(self, key: str) -> list[Callable[[Asked], None]]:
        """Handlers of queries to a key."""
        return self._queryables.reached(key)

    def tokens(self, selector: str) -> list[str]:
        """Keys of the tokens that the party sees, in the order in which they came."""
        if not is_wild(selector):
            return [selector] if selector in self.seen else []
        wanted = zenoh.KeyExpr(selector)
        return [key for key in self.seen if wanted.intersects(zenoh.KeyExpr(key))]

    def show(self, key: str, *, is_there: bool) -> None:
        """A token has come or gone, or is as it was, for this party."""
        if is_there == (key in self.seen):
            return
        if is_there:
            self.seen[key] = None
        else:
            del self.seen[key]
        for take in self._watchers.reached(key):
            take(key, is_there)

    def _token_changed(self, key: str) -> None:
        is_present = bool(self._tokens.reached(key))
        if is_present != (key in self._present):
            self._present.symmetric_difference_update({key})
            self._on_token(key)

    def _forget_routes(self, selector: str) -> None:
        super()._forget_routes(selector)
        self._changed()


class DeclaringLink:
    """Common state of all links within this process; nothing is declared to Zenoh."""

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
