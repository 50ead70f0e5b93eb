"""Delivery within one process: what a lockstep run's components put reaches the others without a way through Zenoh.

Zenoh carries the same puts to other processes, and brings theirs. A message that several inboxes hold is decoded once.
"""

from threading import get_ident
from typing import ClassVar, NamedTuple
from weakref import WeakValueDictionary

import zenoh

from robrain.protocol.wire.border.border import Heard
from robrain.protocol.wire.inbox import Inbox, Sample

ROUTES_MAX = 65536
"""Keys whose subscriptions are remembered."""


class Subscription:
    """One inbox that takes what is put under the keys of a selector.

    Args:
        exchange: where it is registered.
        selector: the key expression.
        topic: what a sample is taken for.
        inbox: takes the samples.

    """

    def __init__(self, exchange: "Exchange", selector: str, topic: Heard, inbox: Inbox) -> None:
        self.topic = topic
        self.inbox = inbox
        self._exchange = exchange
        self._keys = zenoh.KeyExpr(selector)

    def takes(self, key: zenoh.KeyExpr) -> bool:
        """Whether the selector holds a key."""
        return self._keys.intersects(key)

    def undeclare(self) -> None:
        """End it."""
        self._exchange.remove(self)


class Route(NamedTuple):
    """What takes the samples of one key."""

    topic: Heard | None
    """The topic of those samples; None where there are none to take them."""
    plain: list[Inbox]
    """Inboxes that have subscribed to it."""
    special: list[Inbox]
    """Likewise, those that take samples in their own way."""
    others: list[Subscription]
    """What takes such keys as another topic."""


NOBODY = Route(None, [], [], [])
"""Of keys that nothing takes."""


class Exchange:
    """The subscriptions of one session of a lockstep run, and those that each key reaches."""

    _of_session: ClassVar["WeakValueDictionary[str, Exchange]"] = WeakValueDictionary()

    def __init__(self) -> None:
        self._owner = get_ident()
        self._subscriptions: list[Subscription] = []
        self.routes: dict[str, Route] = {}
        """What takes a key, for those that were delivered to."""
        self.is_alone = False
        """Whether no other process can ever hear or say anything here, so that puts need not go through Zenoh."""

    @classmethod
    def of(cls, session: zenoh.Session) -> "Exchange":
        """The one exchange of a session; it goes with the last endpoint that uses it."""
        name = str(session.zid())
        found = cls._of_session.get(name)
        if found is None:
            found = cls._of_session[name] = cls()
        return found

    def subscribe(self, selector: str, topic: Heard, inbox: Inbox) -> Subscription:
        """Have an inbox take what is put under the keys of `selector` from now on."""
        subscription = Subscription(self, selector, topic, inbox)
        self._subscriptions.append(subscription)
        self.routes.clear()
        return subscription

    def remove(self, subscription: Subscription) -> None:
        """End a subscription."""
        self._subscriptions.remove(subscription)
        self.routes.clear()

    def deliver(self, topic: Heard, key: str, payload: bytes) -> None:
        """Hand a sample to all inboxes that take its key; all of them share what one of them decodes."""
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
        else:  # a thread of its own, such as a plugin's server: the run is not repeatable
            for inbox in (*route.plain, *route.special):
                inbox.append(topic, key, payload, outside=True)
            for subscription in route.others:
                subscription.inbox.append(subscription.topic, key, payload, outside=True)

    def _route(self, topic: Heard, key: str) -> Route:
        if len(self.routes) >= ROUTES_MAX:
            self.routes.clear()
        concrete = zenoh.KeyExpr(key)
        taking = [each for each in self._subscriptions if each.takes(concrete)]
        if not taking:
            self.routes[key] = NOBODY
            return NOBODY
        inboxes = [each.inbox for each in taking if each.topic is topic]
        route = self.routes[key] = Route(
            topic,
            [inbox for inbox in inboxes if type(inbox).take is Inbox.take],
            [inbox for inbox in inboxes if type(inbox).take is not Inbox.take],
            [each for each in taking if each.topic is not topic],
        )
        return route
