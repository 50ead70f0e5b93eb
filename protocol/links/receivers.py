"""Parties of a run within one process, their declarations, and who of them receives the samples of a key."""

from collections import Counter
from collections.abc import Callable, Iterable
from threading import Lock
from typing import Generic, NamedTuple, TypeVar

import zenoh

from robrain.protocol.answers.asked import Asked
from robrain.protocol.answers.local_query import Gathering, LocalQuery
from robrain.protocol.border.border import Incoming
from robrain.protocol.links.inbox import Inbox, Sample

T = TypeVar("T")

REACHED_MAX = 65536
"""Keys whose receivers are cached."""


class Entry(Generic[T]):
    """One declaration; see `Declared.add`.

    Args:
        selector: the key expression.
        what: object declared under it.
        forget: ends it.

    """

    __slots__ = ("_forget", "number", "selector", "what")

    def __init__(self, number: int, selector: str, what: T, forget: "Callable[[Entry[T]], None]") -> None:
        self.number = number
        self.selector = selector
        self.what = what
        self._forget = forget

    def undeclare(self) -> None:
        """End it."""
        self._forget(self)


class Declared(Generic[T]):
    """Declarations of one kind.

    Keys match by Zenoh's rules (`zenoh.KeyExpr.intersects`). Two keys without wildcards match if they are equal, so
    only declarations with wildcards are compared. The receivers of a key are cached until a declaration comes or goes.
    Any thread may declare and look.

    Args:
        changed: called with the key expression of each that comes or goes.

    """

    def __init__(self, changed: Callable[[str], None] = lambda _: None) -> None:
        self._changed = changed
        self._changing = Lock()
        self._number = 0
        self._concrete: dict[str, dict[int, Entry[T]]] = {}
        self._wild: dict[int, tuple[zenoh.KeyExpr, Entry[T]]] = {}
        self._reached: dict[str, list[T]] = {}

    def add(self, selector: str, what: T) -> Entry[T]:
        """Declare something."""
        keys = zenoh.KeyExpr(selector)
        with self._changing:
            self._number += 1
            entry = Entry(self._number, selector, what, self._remove)
            if is_wild(selector):
                self._wild[entry.number] = keys, entry
            else:
                self._concrete.setdefault(selector, {})[entry.number] = entry
            self._forget(selector)
        self._changed(selector)
        return entry

    def reached(self, key: str) -> list[T]:
        """Receivers of a key or key expression, in the order of their declaration; read-only."""
        found = self._reached.get(key)
        if found is None:
            with self._changing:
                found = self._find(key)
                if not is_wild(key):
                    if len(self._reached) >= REACHED_MAX:
                        self._reached.clear()
                    self._reached[key] = found
        return found

    def _find(self, key: str) -> list[T]:
        if not is_wild(key) and not self._wild:
            return [each.what for each in self._concrete.get(key, {}).values()]
        asked = zenoh.KeyExpr(key)
        if is_wild(key):
            held = [own for own in self._concrete if asked.intersects(zenoh.KeyExpr(own))]
            entries = [each for own in held for each in self._concrete[own].values()]
        else:
            entries = list(self._concrete.get(key, {}).values())
        entries += [each for keys, each in self._wild.values() if keys.intersects(asked)]
        return [each.what for each in sorted(entries, key=lambda each: each.number)]

    def _remove(self, entry: Entry[T]) -> None:
        with self._changing:
            if is_wild(entry.selector):
                del self._wild[entry.number]
            else:
                same = self._concrete[entry.selector]
                del same[entry.number]
                if not same:
                    del self._concrete[entry.selector]
            self._forget(entry.selector)
        self._changed(entry.selector)

    def _forget(self, selector: str) -> None:
        if is_wild(selector):
            self._reached.clear()
        else:
            self._reached.pop(selector, None)


def is_wild(selector: str) -> bool:
    """Whether a key expression holds more than one key."""
    return "*" in selector


class Party:
    """One life of a robot's or the coordinator's process, or the infrastructure.

    Args:
        name: the party's name.

    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.links = 0
        """Endpoints that are open."""
        self.tokens: Counter[str] = Counter()
        """Its tokens, by key, and how often each is declared."""
        self.seen: dict[str, None] = {}
        """Keys of the tokens that it sees, in the order in which they came."""
        self.is_alive = True
        """False once its process has died: none of its declarations counts."""

    def is_beside(self, other: "Party") -> bool:
        """Whether no network is between the two."""
        return self is other or not (self.name and other.name)


class Subscription(NamedTuple):
    """One inbox that receives puts."""

    topic: Incoming
    """Topic that its samples are read as."""
    inbox: Inbox
    party: Party


class Queryable(NamedTuple):
    """A function that answers queries on the caller's thread."""

    answer: Callable[[Asked], None]
    party: Party

    def answer_late(self, selector: str, payload: bytes) -> None:
        """Handle a request whose caller no longer waits for a reply."""
        self.answer(LocalQuery(Gathering(selector, payload, 1, lambda _: None, lambda: None)))


class Watcher(NamedTuple):
    """A function that is called with each token that comes or goes."""

    accept: Callable[[str, bool], None]
    party: Party


class KeyRoute(NamedTuple):
    """Receivers of the samples of one key."""

    topic: Incoming | None
    """The topic of those samples; None without receivers."""
    plain: list[Inbox]
    """Inboxes that have subscribed to it."""
    rest: list[Subscription]
    """Subscriptions whose inboxes handle samples in their own manner, or that read them as another topic."""
    by_party: dict[Party, "KeyRoute"]
    """Where there is a network: the same, by the receivers' party."""

    def deliver(self, sample: Sample) -> None:
        """Hand a sample to all inboxes, which share one decoded message."""
        if self.plain:
            Inbox.put_into(self.plain, sample)
        if self.rest:
            deliver_rest(self.rest, sample)


def deliver_rest(subscriptions: list[Subscription], sample: Sample) -> None:
    """Hand a sample to inboxes one by one."""
    for topic, inbox, _ in subscriptions:
        if topic is sample[0]:
            inbox.add(sample)
        else:
            inbox.append(topic, sample[1], sample[2])


NOBODY = KeyRoute(None, [], [], {})
"""Of keys without receivers."""


def route_of(topic: Incoming, subscriptions: list[Subscription], parties: Iterable[Party]) -> KeyRoute:
    """The route to subscriptions; `parties` are those to tell apart."""
    if not subscriptions:
        return NOBODY
    route = KeyRoute(topic, [], [], {})
    for each in subscriptions:
        if each.topic is topic and type(each.inbox).add is Inbox.add:
            route.plain.append(each.inbox)
        else:
            route.rest.append(each)
    for party in parties:
        of_party = [each for each in subscriptions if each.party is party]
        if of_party:
            route.by_party[party] = route_of(topic, of_party, ())
    return route
