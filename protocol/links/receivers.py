"""Parties of a run within one process, and who of them receives the samples of a key."""

from collections import Counter
from collections.abc import Callable, Iterable
from typing import NamedTuple

from robrain.protocol.answers.asked import Asked
from robrain.protocol.answers.local_query import Gathering, LocalQuery
from robrain.protocol.border.border import Incoming
from robrain.protocol.links.inbox import Inbox, Sample


class Party:
    """One life of a robot's or the coordinator's process, or the infrastructure.

    Args:
        name: of the party.

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
    """A function that answers queries, on the thread that asks."""

    answer: Callable[[Asked], None]
    party: Party

    def answer_late(self, selector: str, payload: bytes) -> None:
        """Handle a request of which the asker has given up."""
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
