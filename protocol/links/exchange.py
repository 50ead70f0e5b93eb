"""Delivery within one process: puts, queries and tokens between the endpoints of a lockstep run.

Each endpoint belongs to a party: a robot, the coordinator, or the infrastructure (arena, recorder, scripts). A
`Network` decides when a message of a party reaches other parties, if at all. The endpoints of the same party and those
of the infrastructure receive it at once, and all receive messages of the infrastructure at once. Without a network all
endpoints belong to the infrastructure.

- A sample on a LATEST or EVERY topic is sent once. On a LOSSLESS topic the sender keeps the last `cache` samples of a
  key that a receiver has missed. It sends them again, in order: at most `RESEND_NS` after a path exists again.
- A token disappears for a party that its owner has not reached for a while, and comes back with the path.
- A query is answered within the tick if request and reply need no longer than the time limit; otherwise it times out.
  A client that has lost the token of the answering party gets the reply that no participant answered. A reply without a
  waiting caller (`Endpoint.ask_into`) arrives after the sum of both delays.

The process of a party may die or be paused (`drop`, `sleep`).

In a run that other processes may join, Zenoh carries the same puts to them and brings theirs, and carries all queries
and tokens. A message that several inboxes hold is decoded once.
"""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence
from functools import partial
from heapq import heappop, heappush
from threading import get_ident
from typing import ClassVar, Protocol
from weakref import WeakValueDictionary

import zenoh

from robrain.protocol.answers.asked import Answer, Asked
from robrain.protocol.answers.local_query import Gathering, LocalQuery
from robrain.protocol.border.border import Incoming
from robrain.protocol.clock import Clock, VirtualClock, to_ns
from robrain.protocol.links.inbox import Inbox, Sample
from robrain.protocol.links.receivers import (
    NOBODY,
    Declared,
    Entry,
    KeyRoute,
    Party,
    Queryable,
    Subscription,
    Watcher,
    deliver_rest,
    is_wild,
    route_of,
)
from robrain.protocol.messages.team.arena_messages import LinkCounters
from robrain.protocol.topic import Delivery, Topic

COORDINATOR = "coordinator"
"""The coordinator's party; robots are parties by their names."""
EVERYWHERE = ""
"""The party of arena, recorder and scripts: every message reaches it at once."""
ROUTES_MAX = 65536
"""Keys whose receivers are cached."""


class Network(Protocol):
    """Decides who receives a message between parties, when, or not at all.

    Times are in nanoseconds of the run's clock, sizes in bytes.
    """

    counters: LinkCounters
    """Outcome of the messages up to now."""
    parties: Sequence[str]
    """All parties that may join; any if empty."""
    is_open: bool
    """Whether every message now arrives at once."""

    def update(self, now_ns: int, on: Collection[str]) -> bool:
        """Update which parties reach each other; returns False if it is not yet time. `on` have open endpoints."""

    def reaches(self, source: str, target: str) -> bool:
        """Whether there is a path from one party to another."""

    def spread(self, source: str, targets: Sequence[str], size: int, now_ns: int) -> dict[str, int]:
        """Send a sample once; returns how long it takes to each target that it reaches, and counts the others."""

    def overtakes(self, source: str, target: str) -> bool:
        """Whether samples from one party to another may overtake earlier ones now."""

    def carry(self, source: str, target: str, size: int, now_ns: int, limit_ns: int) -> int | None:
        """Send a request or a reply; returns how long it takes, None if it is lost or given up."""


RESEND_NS = to_ns(0.5)
"""Period in which a receiver finds out which samples of a lossless topic it has missed: Zenoh's heartbeat, see
`ZenohLink`."""
IN_FLIGHT_MAX = 65536
"""Samples and replies in flight; further ones are dropped and counted."""


class _Missed:
    """Samples of one key of a lossless topic that one receiver has missed."""

    def __init__(self, sender: Party, kept: int, retry_ns: int) -> None:
        self.sender = sender
        self.samples: deque[Sample] = deque(maxlen=kept)
        self.retry_ns = retry_ns


class Exchange:
    """Decides the receivers of puts, of queries and of tokens, on one session of a lockstep run.

    The receivers of a key get it in the order in which they were declared.

    Args:
        is_alone: whether no other process can ever join here, so that Zenoh is not needed.
        network: between the parties; None where every message arrives at once.
        clock: of the run, for the network.
        lost_after_s: how long a token is seen after its owner's last message.
        answers_after_s: time after which queries to a party that was lost are answered again; its token comes at once.

    """

    _of_session: ClassVar["WeakValueDictionary[str, Exchange]"] = WeakValueDictionary()

    def __init__(
        self,
        *,
        is_alone: bool = False,
        network: Network | None = None,
        clock: Clock | None = None,
        lost_after_s: float = 0.0,
        answers_after_s: float = 0.0,
    ) -> None:
        self.is_alone = is_alone
        self._owner = get_ident()
        self._network = network
        self._clock: Clock = VirtualClock() if clock is None else clock
        self._lost_after_ns = to_ns(lost_after_s)
        self._answers_after_ns = to_ns(answers_after_s)
        self._subscriptions: Declared[Subscription] = Declared(self._forget_routes)
        self._queryables: Declared[Queryable] = Declared()
        self._watchers: Declared[Watcher] = Declared()
        self.routes: dict[str, KeyRoute] = {}
        """Receivers by key, for the keys of delivered samples."""
        self.infrastructure = Party(EVERYWHERE)
        self._parties: dict[str, Party] = {EVERYWHERE: self.infrastructure}
        self._reached_ns: dict[tuple[str, str], int] = {}
        """Time when a party (the first) last reached another, while the other counts on it."""
        self._open_ns = 0
        """Time when all last reached each other."""
        self._returning: set[tuple[str, str]] = set()
        """Such pairs between which no query is answered yet, or which are lost."""
        self._in_flight: list[tuple[int, int, Callable[[], object]]] = []
        self._number = 0
        self._last_ns: dict[tuple[str, str], int] = {}
        """When the last sample from one party to another arrives."""
        self._has_dropped = False
        """Whether a party was dropped since the reach was last updated; it may be back before the network notices."""
        self._missed: dict[tuple[str, Party], _Missed] = {}
        """By key and receiver."""
        self._paused: dict[str, list[Callable[[], None]]] = {}
        """Requests that wait for each party whose process is paused."""

    @classmethod
    def of(cls, session: zenoh.Session) -> "Exchange":
        """The one exchange of a session; it goes with the last endpoint that uses it."""
        found = cls._of_session.get(str(session.zid()))
        return cls().serve(session) if found is None else found

    @classmethod
    def alone(cls, session: zenoh.Session) -> "Exchange":
        """That of a session that no other process can join and on which nothing is declared yet."""
        return cls(is_alone=True).serve(session)

    def serve(self, session: zenoh.Session) -> "Exchange":
        """Connect the endpoints of a session, on which nothing is declared yet."""
        self._of_session[str(session.zid())] = self
        return self

    # -- parties --------------------------------------------------------------------------------------------

    def join(self, name: str) -> Party:
        """The party of an endpoint that is opened.

        Raises:
            ValueError: the network does not know the party.

        """
        if (network := self._network) is None:
            return self.infrastructure
        party = self._parties.get(name)
        if party is None:
            known = network.parties
            if known and name not in known:
                raise ValueError(f"expected a party with a radio, got {name!r}: {', '.join(known)}")
            party = self._parties[name] = Party(name)
        party.links += 1
        if party.links == 1 and name:
            self._update_reach(network)
            for sender in self._parties.values():
                self._show_tokens(sender.tokens, party)
        return party

    def leave(self, party: Party) -> None:
        """A party closes an endpoint; with the last one it relays nothing more."""
        party.links -= 1

    def drop(self, name: str) -> None:
        """A party's process has died: none of its declarations exists any more, and it sends nothing more.

        Messages in flight to it are dropped. Declarations of endpoints of this party stay without effect, also when
        another process is started.
        """
        self._paused.pop(name, None)
        party = self._parties.pop(name, None)
        if party is None:
            return
        party.is_alive, self._has_dropped = False, True
        for at in [at for at, missed in self._missed.items() if party in (at[1], missed.sender)]:
            del self._missed[at]
        for pair in [pair for pair in (*self._reached_ns, *self._returning) if name in pair]:
            self._reached_ns.pop(pair, None)
            self._returning.discard(pair)
        self.routes.clear()
        self._show_tokens(party.tokens)

    def sleep(self, name: str) -> None:
        """A party's process is paused: requests to it wait, and their callers get no answer in time."""
        self._paused.setdefault(name, [])

    def wake(self, name: str) -> None:
        """It continues, and handles the waiting requests."""
        for handle in self._paused.pop(name, ()):
            handle()

    def step(self) -> None:
        """Update which parties reach each other, and deliver the messages that have arrived meanwhile."""
        if (network := self._network) is None:
            return
        now_ns = self._clock.now_ns()
        self._update_reach(network)
        while self._in_flight and self._in_flight[0][0] <= now_ns:
            heappop(self._in_flight)[2]()
        for at in [at for at, missed in self._missed.items() if now_ns >= missed.retry_ns]:
            self._send_again(network, at, self._missed[at], now_ns)

    # -- samples --------------------------------------------------------------------------------------------

    def subscribe(self, selector: str, topic: Incoming, inbox: Inbox, party: Party) -> Entry[Subscription]:
        """Deliver all puts under the keys of `selector` to an inbox from now on."""
        return self._subscriptions.add(selector, Subscription(topic, inbox, party))

    def deliver(self, sender: Party, topic: Incoming, key: str, payload: bytes) -> None:
        """Hand a sample to all inboxes that subscribe to its key and that it reaches."""
        route = self.routes.get(key)
        if route is NOBODY:
            return
        if route is None or route.topic is not topic:
            route = self._route(topic, key)
        network = self._network
        if get_ident() != self._owner:
            self._deliver_from_thread(sender, key, payload)
        elif network is None or not sender.name:
            sample: Sample = (topic, key, payload, [])
            if route.plain:
                Inbox.put_into(route.plain, sample)
            if route.rest:
                deliver_rest(route.rest, sample)
        elif (living := self._living(sender)) is not None:
            if network.is_open and not self._in_flight and not self._missed:
                route.deliver((topic, key, payload, []))
            else:
                self._send(network, living, route, (topic, key, payload, []))

    def _deliver_from_thread(self, sender: Party, key: str, payload: bytes) -> None:
        """The same for a separate thread, such as a plugin's server: the run is not repeatable."""
        network = self._network
        for topic, inbox, receiver in self._subscriptions.reached(key):
            is_reached = network is None or sender.is_beside(receiver) or network.reaches(sender.name, receiver.name)
            if is_reached and sender.is_alive and receiver.is_alive:
                inbox.append(topic, key, payload, outside=True)

    def _living(self, party: Party) -> Party | None:
        """The party's present life; None if its process is dead."""
        return party if party.is_alive else self._parties.get(party.name)

    def _route(self, topic: Incoming, key: str) -> KeyRoute:
        if len(self.routes) >= ROUTES_MAX:
            self.routes.clear()
        found = [each for each in self._subscriptions.reached(key) if each.party.is_alive]
        route = self.routes[key] = route_of(topic, found, [] if self._network is None else self._parties.values())
        return route

    def _forget_routes(self, selector: str) -> None:
        if is_wild(selector):
            self.routes.clear()
        else:
            self.routes.pop(selector, None)

    def _send(self, network: Network, sender: Party, route: KeyRoute, sample: Sample) -> None:
        """Send a party's sample to all parties that have subscribed to it."""
        receivers = []
        for party, of_party in route.by_party.items():
            if sender.is_beside(party):
                of_party.deliver(sample)
            else:
                receivers.append(party)
        if not receivers:
            return
        now_ns = self._clock.now_ns()
        topic, key = sample[0], sample[1]
        is_kept = isinstance(topic, Topic) and topic.delivery is Delivery.LOSSLESS
        if is_kept and self._missed:
            waiting = [self._missed.get((key, receiver)) for receiver in receivers]
            receivers = [receiver for receiver, missed in zip(receivers, waiting, strict=True) if missed is None]
            for missed in waiting:
                if missed is not None:
                    self._keep(network, missed, sample)
        delays_ns = network.spread(sender.name, [receiver.name for receiver in receivers], _size(sample), now_ns)
        for receiver in receivers:
            if receiver.name in delays_ns:
                self._arrive(network, sender, receiver, now_ns + delays_ns[receiver.name], sample)
            elif is_kept:
                assert isinstance(topic, Topic)
                missed = self._missed[key, receiver] = _Missed(sender, topic.cache, now_ns + RESEND_NS)
                self._keep(network, missed, sample)

    def _keep(self, network: Network, missed: _Missed, sample: Sample) -> None:
        network.counters.outdated += len(missed.samples) == missed.samples.maxlen
        missed.samples.append(sample)

    def _send_again(self, network: Network, at: tuple[str, Party], missed: _Missed, now_ns: int) -> None:
        missed.retry_ns = now_ns + RESEND_NS
        sender, receiver = missed.sender, at[1]
        if not sender.links:
            del self._missed[at]  # with the sender, its stored samples have gone
            return
        if not network.reaches(sender.name, receiver.name):
            return
        while missed.samples:
            sample = missed.samples[0]
            delays_ns = network.spread(sender.name, [receiver.name], _size(sample), now_ns)
            if receiver.name not in delays_ns:
                return
            missed.samples.popleft()
            self._arrive(network, sender, receiver, now_ns + delays_ns[receiver.name], sample)
        del self._missed[at]

    def _arrive(self, network: Network, sender: Party, receiver: Party, due_ns: int, sample: Sample) -> None:
        """Hand a sample over when it arrives, after all that the sender has sent there before."""
        pair = sender.name, receiver.name
        last_ns = self._last_ns.get(pair, 0)
        if due_ns < last_ns and not network.overtakes(*pair):
            due_ns = last_ns
        self._last_ns[pair] = max(due_ns, last_ns)
        network.counters.delivered += self._at(due_ns, partial(self._hand_over, receiver, sample))

    def _hand_over(self, receiver: Party, sample: Sample) -> None:
        topic, key = sample[0], sample[1]
        route = self.routes.get(key)
        if route is None or (route is not NOBODY and route.topic is not topic):
            route = self._route(topic, key)
        of_party = route.by_party.get(receiver)
        if of_party is not None:
            of_party.deliver(sample)

    def _at(self, due_ns: int, act: Callable[[], object]) -> bool:
        """Do something now or when it is due; returns False if there is no room for it."""
        if due_ns <= self._clock.now_ns():
            act()
        elif len(self._in_flight) >= IN_FLIGHT_MAX:
            if self._network is not None:
                self._network.counters.overflowed += 1
            return False
        else:
            self._number += 1
            heappush(self._in_flight, (due_ns, self._number, act))
        return True

    # -- queries --------------------------------------------------------------------------------------------

    def queryable(self, selector: str, answer: Callable[[Asked], None], party: Party) -> Entry[Queryable]:
        """Answer queries to the keys of `selector` on the caller's thread."""
        return self._queryables.add(selector, Queryable(answer, party))

    def ask(
        self,
        asker: Party,
        selector: str,
        payload: bytes,
        limit_ns: int,
        accept: Callable[[Answer], None],
        over: Callable[[], None],
        *,
        waits: bool,
    ) -> bool:
        """Send a query to all endpoints that answer it; they have answered, or have kept the query, when this returns.

        Args:
            asker: party of the caller.
            selector: key expression, and parameters behind a `?`.
            payload: the request.
            limit_ns: time limit for request and reply together, on the network.
            accept: gets the replies.
            over: called after the last one.
            waits: whether the caller waits, so that `accept` gets each reply now; otherwise when it arrives.

        Returns:
            Whether all requests and replies arrived within the limit.

        """
        network, key = self._network, selector.partition("?")[0]
        found = [each for each in self._queryables.reached(key) if each.party.is_alive]
        if network is None or (network.is_open and not self._paused and not self._returning and asker.is_alive):
            gathering = Gathering(selector, payload, len(found), accept, over)
            for each in found:
                each.answer(LocalQuery(gathering))
            return True
        living = self._living(asker)
        if living is None:
            over()
            return True
        query = _NetworkQuery(network, self._clock.now_ns(), limit_ns)
        asked: list[tuple[Queryable, int]] = []
        for party in self._parties.values():
            queryables = [each for each in found if each.party is party]
            if queryables and self._is_answered(party, living):
                network.counters.asked += not living.is_beside(party)
                there_ns = query.carry(living, party, len(selector) + len(payload), 0)
                if there_ns is not None and (there_ns > limit_ns or party.name in self._paused):
                    query.fail()
                    self._at(query.now_ns + there_ns, partial(self._hand_over_late, queryables, selector, payload))
                elif there_ns is not None:
                    asked += [(each, there_ns) for each in queryables]
        left = len(asked)

        def one_over() -> None:
            nonlocal left
            left -= 1
            if not left:
                over()

        def reply(party: Party, there_ns: int, answer: Answer) -> None:
            duration_ns = query.carry(party, living, len(answer.key) + len(answer.payload), there_ns)
            if duration_ns is not None and duration_ns > limit_ns:
                query.fail()
            elif duration_ns is not None:
                self._at(self._clock.now_ns() + (0 if waits else duration_ns), partial(accept, answer))

        if not asked:
            over()
        for queryable, there_ns in asked:
            back = partial(reply, queryable.party, there_ns)
            queryable.answer(LocalQuery(Gathering(selector, payload, 1, back, one_over)))
        return query.is_in_time

    def _is_answered(self, party: Party, asker: Party) -> bool:
        """Whether an asker knows the queryables of a party."""
        pair = party.name, asker.name
        return party.is_beside(asker) or (pair in self._reached_ns and pair not in self._returning)

    def _hand_over_late(self, queryables: list[Queryable], selector: str, payload: bytes) -> None:
        """Deliver a request whose caller no longer waits for a reply, unless its receiver has died."""
        for queryable in queryables:
            party = queryable.party
            if party.is_alive and party.name in self._paused:
                self._paused[party.name].append(partial(queryable.answer_late, selector, payload))
            elif party.is_alive:
                queryable.answer_late(selector, payload)

    # -- tokens ---------------------------------------------------------------------------------------------

    def token(self, key: str, party: Party) -> Entry[Party]:
        """Declare presence; several tokens of one key are one for their observers."""
        party.tokens[key] += 1
        self._show_tokens((key,))
        return Entry(0, key, party, self._end_token)

    def _end_token(self, entry: Entry[Party]) -> None:
        tokens, key = entry.what.tokens, entry.selector
        tokens[key] -= 1
        if not tokens[key]:
            del tokens[key]
        self._show_tokens((key,))

    def watch(self, selector: str, accept: Callable[[str, bool], None], party: Party) -> Entry[Watcher]:
        """Have tokens followed: those that are there, then each that comes or goes."""
        for key in self.tokens(selector, party):
            accept(key, True)
        return self._watchers.add(selector, Watcher(accept, party))

    def tokens(self, selector: str, party: Party) -> list[str]:
        """Keys of the tokens that a party sees, in the order in which they came."""
        if not is_wild(selector):
            return [selector] if selector in party.seen else []
        wanted = zenoh.KeyExpr(selector)
        return [key for key in party.seen if wanted.intersects(zenoh.KeyExpr(key))]

    def _show_tokens(self, keys: Iterable[str], receiver: Party | None = None) -> None:
        """Tell one party or all of tokens that have come or gone, unless they see them as they are."""
        parties = self._parties.values() if receiver is None else (receiver,)
        for key in sorted(keys):
            owners = [party for party in self._parties.values() if key in party.tokens]
            for party in parties:
                is_there = any(self._is_seen(owner, party) for owner in owners)
                if is_there == (key in party.seen):
                    continue
                if is_there:
                    party.seen[key] = None
                else:
                    del party.seen[key]
                for watcher in self._watchers.reached(key):
                    if watcher.party is party:
                        watcher.accept(key, is_there)

    def _is_seen(self, owner: Party, party: Party) -> bool:
        return owner.is_beside(party) or (owner.name, party.name) in self._reached_ns

    def _update_reach(self, network: Network) -> None:
        """Update which parties count on each other, from the reach of the network now."""
        reached_ns, now_ns = self._reached_ns, self._clock.now_ns()
        if network.is_open:
            self._open_ns = now_ns
        parties = [party for name, party in self._parties.items() if name]
        if not (network.update(now_ns, [party.name for party in parties if party.links]) or self._has_dropped):
            return
        self._has_dropped = False
        for sender in parties:
            for receiver in parties:
                pair = sender.name, receiver.name
                if sender is receiver:
                    continue
                if network.reaches(*pair):
                    is_new = pair not in reached_ns
                    reached_ns[pair] = now_ns
                    if is_new:
                        if pair in self._returning:
                            self._at(now_ns + self._answers_after_ns, partial(self._returning.discard, pair))
                        self._show_tokens(sender.tokens, receiver)
                elif pair in reached_ns and now_ns - max(reached_ns[pair], self._open_ns) > self._lost_after_ns:
                    del reached_ns[pair]
                    self._returning.add(pair)
                    self._show_tokens(sender.tokens, receiver)


class _NetworkQuery:
    """A query in flight.

    Args:
        network: how long request and reply take.
        now_ns: when it is sent.
        limit_ns: time limit for request and reply together.

    """

    def __init__(self, network: Network, now_ns: int, limit_ns: int) -> None:
        self.is_in_time = True
        """Whether each request and reply so far has arrived within the limit."""
        self.now_ns = now_ns
        self._network = network
        self._limit_ns = limit_ns

    def carry(self, sender: Party, receiver: Party, size: int, before_ns: int) -> int | None:
        """How long a request or reply takes, and its predecessor; None if it is lost."""
        if sender.is_beside(receiver):
            return before_ns
        limit_ns = self._limit_ns - before_ns
        duration_ns = self._network.carry(sender.name, receiver.name, size, self.now_ns, limit_ns)
        if duration_ns is None:
            self.fail()
            return None
        return before_ns + duration_ns

    def fail(self) -> None:
        """A request or reply is lost or late."""
        self.is_in_time = False
        self._network.counters.timed_out += 1


def _size(sample: Sample) -> int:
    """Bytes that a sample takes on the network."""
    return len(sample[1]) + len(sample[2])
