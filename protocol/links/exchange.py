"""Delivery within one process, without Zenoh: puts, queries and declarations of the components of a lockstep run.

In a run that other processes may join, Zenoh carries the same puts to them and brings theirs, and carries all queries
and tokens. A message that several inboxes hold is decoded once.
"""

from collections.abc import Callable
from threading import Lock, get_ident
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, TypeVar
from weakref import WeakValueDictionary

import zenoh

from robrain.protocol.answers.asked import Answer, Asked
from robrain.protocol.answers.local_query import Gathering, LocalQuery
from robrain.protocol.border.border import Heard
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


ROUTES_MAX = 65536
"""Keys whose subscriptions are cached."""


class Subscription(NamedTuple):
    """One inbox that receives puts."""

    topic: Heard
    """Topic that its samples are read as."""
    inbox: Inbox


class KeyRoute(NamedTuple):
    """Receivers of the samples of one key."""

    topic: Heard | None
    """The topic of those samples; None where there are none to take them."""
    plain: list[Inbox]
    """Inboxes that have subscribed to it."""
    special: list[Inbox]
    """Likewise, those that handle samples in their own manner."""
    others: list[Subscription]
    """Subscriptions that read these samples as another topic."""


NOBODY = KeyRoute(None, [], [], [])
"""Of keys that nothing takes."""


class Delivering(Protocol):
    """Carries the puts of publishers."""

    def deliver(self, topic: Heard, key: str, payload: bytes) -> None:
        """Hand a sample to all inboxes that take its key and that it reaches."""


class Exchange:
    """Decides the receivers of puts, of queries and of tokens, on one session of a lockstep run.

    The receivers of a key get it in the order in which they were declared.

    Args:
        is_alone: whether no other process can ever join here, so that Zenoh is not needed.

    """

    _of_session: ClassVar["WeakValueDictionary[str, Exchange]"] = WeakValueDictionary()

    def __init__(self, *, is_alone: bool = False) -> None:
        self.is_alone = is_alone
        self._owner = get_ident()
        self._subscriptions: Declared[Subscription] = Declared(self._forget_routes)
        self._queryables: Declared[Callable[[Asked], None]] = Declared()
        self._watchers: Declared[Callable[[str, bool], None]] = Declared()
        self._tokens: Declared[str] = Declared(self._token_changed)
        self._present: set[str] = set()
        self.routes: dict[str, KeyRoute] = {}
        """Receivers by key, for the keys of delivered samples."""

    @classmethod
    def of(cls, session: zenoh.Session) -> "Exchange":
        """The one exchange of a session; it goes with the last endpoint that uses it."""
        name = str(session.zid())
        found = cls._of_session.get(name)
        if found is None:
            found = cls._of_session[name] = cls()
        return found

    @classmethod
    def alone(cls, session: zenoh.Session) -> "Exchange":
        """That of a session that no other process can join and on which nothing is declared yet."""
        made = cls._of_session[str(session.zid())] = cls(is_alone=True)
        return made

    def subscribe(self, selector: str, topic: Heard, inbox: Inbox) -> Entry[Subscription]:
        """Deliver all puts under the keys of `selector` to an inbox from now on."""
        return self._subscriptions.add(selector, Subscription(topic, inbox))

    def queryable(self, selector: str, take: Callable[[Asked], None]) -> Entry[Any]:
        """Have queries to the keys of `selector` answered, on the thread that asks."""
        return self._queryables.add(selector, take)

    def token(self, key: str) -> Entry[Any]:
        """Declare presence; several tokens of one key are one for their observers."""
        return self._tokens.add(key, key)

    def watch(self, selector: str, take: Callable[[str, bool], None]) -> Entry[Any]:
        """Have tokens followed: those that are there, then each that comes or goes."""
        for key in self.tokens(selector):
            take(key, True)
        return self._watchers.add(selector, take)

    def tokens(self, selector: str) -> list[str]:
        """Keys of the tokens that are there, in the order in which they came."""
        return list(dict.fromkeys(self._tokens.reached(selector)))

    def ask(self, selector: str, payload: bytes, take: Callable[[Answer], None], over: Callable[[], None]) -> None:
        """Send a query to all endpoints that answer it; they have answered, or have kept the query, when this returns.

        Args:
            selector: key expression, and parameters behind a `?`.
            payload: the request.
            take: gets the replies.
            over: called after the last one.

        """
        asked = self._queryables.reached(selector.partition("?")[0])
        gathering = Gathering(selector, payload, len(asked), take, over)
        for answer in asked:
            answer(LocalQuery(gathering))

    def deliver(self, topic: Heard, key: str, payload: bytes) -> None:
        """Hand a sample to all inboxes that subscribe to its key; all of them share one decoded message."""
        route = self.routes.get(key)
        if route is NOBODY:
            return
        if route is None or route.topic is not topic:
            route = self._route(topic, key)
        if get_ident() == self._owner:
            sample: Sample = (topic, key, payload, [])
            if route.plain:
                Inbox.put_into(route.plain, sample)
            for inbox in route.special:
                inbox.take(sample)
            for subscription in route.others:
                subscription.inbox.append(subscription.topic, key, payload)
        else:  # a separate thread, such as a plugin's server: the run is not repeatable
            for inbox in (*route.plain, *route.special):
                inbox.append(topic, key, payload, outside=True)
            for subscription in route.others:
                subscription.inbox.append(subscription.topic, key, payload, outside=True)

    def _route(self, topic: Heard, key: str) -> KeyRoute:
        if len(self.routes) >= ROUTES_MAX:
            self.routes.clear()
        taking = self._subscriptions.reached(key)
        if not taking:
            self.routes[key] = NOBODY
            return NOBODY
        inboxes = [each.inbox for each in taking if each.topic is topic]
        route = self.routes[key] = KeyRoute(
            topic,
            [inbox for inbox in inboxes if type(inbox).take is Inbox.take],
            [inbox for inbox in inboxes if type(inbox).take is not Inbox.take],
            [each for each in taking if each.topic is not topic],
        )
        return route

    def _forget_routes(self, selector: str) -> None:
        if is_wild(selector):
            self.routes.clear()
        else:
            self.routes.pop(selector, None)

    def _token_changed(self, key: str) -> None:
        is_present = bool(self._tokens.reached(key))
        if is_present == (key in self._present):
            return
        self._present.symmetric_difference_update({key})
        for take in self._watchers.reached(key):
            take(key, is_present)
