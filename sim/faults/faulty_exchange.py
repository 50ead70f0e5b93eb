"""An exchange on which messages get lost, come late or out of order, and components are cut off, hang or die.

The runner sets the component that runs its step (`acting`). Declarations, messages and queries of that step belong to
this component. `WireFaults` decides which messages are lost or late. Without a fault everything passes as on
`Exchange`.

If the request or reply of a query is lost or late, the query fails at once with Zenoh's text for a timeout. A late
request is still handled when it arrives. On a real wire the sender has given up by then, too. Tokens and queryables of
disconnected components disappear after Zenoh's lease. When the link is back the tokens come first, the queryables
later.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from heapq import heappop, heappush
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import zenoh

from robrain.protocol.answers.asked import Answer, Asked
from robrain.protocol.answers.later import ZENOH_TIMEOUT
from robrain.protocol.answers.local_query import Gathering, LocalQuery
from robrain.protocol.border.border import Heard
from robrain.protocol.clock import Clock, to_ns
from robrain.protocol.links.exchange import Entry, Exchange, Subscription
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.wire.session import LEASE_MS
from robrain.sim.faults.fault_spec import FaultKind, FaultSpec


class Cut(NamedTuple):
    """A fault of the wire that has begun."""

    fault: FaultSpec
    side: frozenset[str]
    since_ns: int

    @property
    def is_partition(self) -> bool:
        """Whether no message crosses it."""
        return self.fault.kind is FaultKind.PARTITION

    def crosses(self, one: str, other: str) -> bool:
        """Whether it is between two components; an empty name is no component."""
        return bool(one and other) and (one in self.side) != (other in self.side)


class WireFaults:
    """The faults of the wire that are in force.

    Args:
        clock: of the run.
        seed: of the run, from which losses and delays are drawn.

    """

    def __init__(self, clock: Clock, seed: int) -> None:
        self.lost = 0
        """Messages, requests and replies that were lost so far."""
        self._clock = clock
        self._rng = np.random.default_rng([seed, 11])
        self._cuts: dict[int, Cut] = {}
        self._latest_ns: dict[tuple[str, str], int] = {}

    def __bool__(self) -> bool:
        """Whether there is any."""
        return bool(self._cuts)

    def __iter__(self) -> Iterator[Cut]:
        """The faults in the order in which they began."""
        return iter(self._cuts.values())

    def begin(self, number: int, fault: FaultSpec) -> None:
        """A fault begins."""
        self._cuts[number] = Cut(fault, frozenset((fault.robot, *fault.side)), self._clock.now_ns())

    def end(self, number: int) -> Cut:
        """A fault ends; returns it."""
        self._latest_ns.clear()
        return self._cuts.pop(number)

    def is_linked(self, one: str, other: str) -> bool:
        """Whether no partition is between two components."""
        return not any(cut.is_partition and cut.crosses(one, other) for cut in self._cuts.values())

    def reorders(self, one: str, other: str) -> bool:
        """Whether messages between two components overtake each other."""
        return any(cut.fault.kind is FaultKind.REORDER and cut.crosses(one, other) for cut in self._cuts.values())

    def fate(self, sender: str, receiver: str) -> int | None:
        """By how much a message is late, ns; None if it is lost."""
        late_ns, now_ns = 0, self._clock.now_ns()
        for cut in self._cuts.values():
            if not cut.crosses(sender, receiver):
                continue
            fault = cut.fault
            if fault.kind is FaultKind.PARTITION:
                return None
            if fault.share is not None and self._rng.random() < fault.share:
                return None
            if fault.late_s is not None:
                drawn_ns = to_ns(float(self._rng.uniform(*fault.late_s)))
                if fault.kind is FaultKind.DELAY:
                    pair = (sender, receiver)
                    due_ns = self._latest_ns[pair] = max(self._latest_ns.get(pair, 0), now_ns + drawn_ns)
                    drawn_ns = due_ns - now_ns
                late_ns = max(late_ns, drawn_ns)
        return late_ns


TOKEN_LEASE_NS = LEASE_MS * 1_000_000
QUERYABLE_LATE_NS = to_ns(0.4)
"""After a cut, queryables are declared again this much later than tokens (chosen)."""
NOBODY = ""
"""Acts when no component's step is taken; no fault touches it."""


class _Answerer:
    """A queryable, its owner, and the life of the owner in which it was declared."""

    def __init__(self, exchange: "FaultyExchange", owner: str, life: int, take: Callable[[Asked], None]) -> None:
        self.exchange = exchange
        self.owner = owner
        self.life = life
        self.take = take

    def __call__(self, asked: Asked, /) -> None:
        with self.exchange.acting(self.owner):
            self.take(asked)


class _Watcher:
    """Subscriber to tokens, and the tokens that it sees."""

    def __init__(self, owner: str, selector: str, take: Callable[[str, bool], None]) -> None:
        self.owner = owner
        self.keys = zenoh.KeyExpr(selector)
        self.take = take
        self.seen: set[str] = set()


class FaultyExchange(Exchange):
    """The exchange of a run with faults of processes and of the wire.

    Args:
        clock: of the run, by which late messages arrive.
        seed: draws losses and delays.

    """

    def __init__(self, clock: Clock, seed: int) -> None:
        super().__init__(is_alone=True)
        self.at = NOBODY
        """The component that acts."""
        self.faults = WireFaults(clock, seed)
        """Faults of the wire that are in force; begin and end them by the functions of this class."""
        self._clock = clock
        self._healing: dict[int, Cut] = {}
        """Cuts that have ended, across which no queryable is known yet."""
        self._asleep: dict[str, list[Callable[[], None]]] = {}
        """Pending calls of each component that does not answer now."""
        self._owners: WeakKeyDictionary[Inbox, str] = WeakKeyDictionary()
        self._entries: dict[str, list[Entry[Any]]] = {}
        self._dead: set[str] = set()
        """Components that have died; their remaining endpoints publish nothing more."""
        self._lives: dict[str, int] = {}
        self._token_owners: dict[str, str] = {}
        self._late: list[tuple[int, int, Callable[[], object]]] = []
        self._number = 0
        self._watching: dict[int, _Watcher] = {}
        self._check_ns: int | None = None

    @classmethod
    def on(cls, session: zenoh.Session, clock: Clock, seed: int) -> "FaultyExchange":
        """Make the endpoints of a session that no other process can join use such an exchange from now on."""
        made = cls(clock, seed)
        cls._of_session[str(session.zid())] = made
        return made

    @contextmanager
    def acting(self, component: str) -> Iterator[None]:
        """Everything within the block is done by this component."""
        before, self.at = self.at, component
        try:
            yield
        finally:
            self.at = before

    # -- faults ---------------------------------------------------------------------------------------------

    def begin(self, number: int, fault: FaultSpec) -> None:
        """A fault of the wire begins."""
        self.faults.begin(number, fault)
        self._check_ns = self._clock.now_ns() + TOKEN_LEASE_NS + 1

    def end(self, number: int) -> None:
        """A fault of the wire ends."""
        cut = self.faults.end(number)
        if cut.is_partition and self._clock.now_ns() - cut.since_ns > TOKEN_LEASE_NS:
            self._healing[number] = cut
            self._later(QUERYABLE_LATE_NS, lambda: self._healing.pop(number, None))
        self._look()

    @property
    def lost(self) -> int:
        """See FaultyWire."""
        return self.faults.lost

    def sleep(self, component: str, *, is_hung: bool) -> None:
        """A component answers nothing until it wakes up; requests wait for it."""
        self._asleep.setdefault(component, [])

    def wake(self, component: str) -> None:
        """The component has woken up, and handles its waiting requests."""
        for do in self._asleep.pop(component, ()):
            do()

    def drop(self, component: str) -> None:
        """A component's process has died: all its declarations are gone, and it publishes nothing more."""
        self._dead.add(component)
        self._asleep.pop(component, None)
        self._lives[component] = self.life_of(component) + 1
        for entry in self._entries.pop(component, []):
            entry.undeclare()

    def begin_life(self, component: str) -> None:
        """A component's process is started."""
        self._dead.discard(component)

    def life_of(self, component: str) -> int:
        """Number of deaths of a component."""
        return self._lives.get(component, 0)

    def step(self) -> None:
        """Deliver late messages that are due now; call it once a tick, before the components' steps."""
        now_ns = self._clock.now_ns()
        while self._late and self._late[0][0] <= now_ns:
            heappop(self._late)[2]()
        if self._check_ns is not None and now_ns >= self._check_ns:
            self._check_ns = None
            self._look()

    # -- declarations ---------------------------------------------------------------------------------------

    def subscribe(self, selector: str, topic: Heard, inbox: Inbox) -> Entry[Subscription]:
        """See Exchange."""
        self._owners[inbox] = self.at
        return self._keep(super().subscribe(selector, topic, inbox))

    def queryable(self, selector: str, take: Callable[[Asked], None]) -> Entry[Any]:
        """See Exchange."""
        return self._keep(super().queryable(selector, _Answerer(self, self.at, self.life_of(self.at), take)))

    def token(self, key: str) -> Entry[Any]:
        """See Exchange."""
        self._token_owners[key] = self.at
        return self._keep(super().token(key))

    def watch(self, selector: str, take: Callable[[str, bool], None]) -> Entry[Any]:
        """See Exchange."""
        watcher = _Watcher(self.at, selector, take)
        self._number += 1
        number = self._number
        self._watching[number] = watcher
        self._show(watcher)
        return self._keep(Entry(number, selector, watcher, lambda entry: self._unwatch(entry.number)))

    def _unwatch(self, number: int) -> None:
        del self._watching[number]

    def tokens(self, selector: str) -> list[str]:
        """See Exchange."""
        return [key for key in super().tokens(selector) if self._sees(self.at, key)]

    def _keep(self, entry: Entry[Any]) -> Entry[Any]:
        kept = self._entries.setdefault(self.at, [])
        ended = False

        def forget(_entry: Entry[Any]) -> None:
            nonlocal ended
            if not ended:
                ended = True
                entry.undeclare()

        once = Entry(entry.number, entry.selector, entry.what, forget)
        kept.append(once)
        return once

    # -- tokens ---------------------------------------------------------------------------------------------

    def _token_changed(self, key: str) -> None:
        for watcher in list(self._watching.values()):
            self._show(watcher)

    def _look(self) -> None:
        for watcher in list(self._watching.values()):
            self._show(watcher)

    def _show(self, watcher: _Watcher) -> None:
        there = {key for key in super().tokens(str(watcher.keys)) if self._sees(watcher.owner, key)}
        for key in sorted(there ^ watcher.seen):
            watcher.take(key, key in there)
        watcher.seen = there

    def _sees(self, watcher: str, key: str) -> bool:
        owner, now_ns = self._token_owners.get(key, NOBODY), self._clock.now_ns()
        return not any(
            cut.is_partition and now_ns - cut.since_ns > TOKEN_LEASE_NS and cut.crosses(watcher, owner)
            for cut in self.faults
        )

    # -- messages -------------------------------------------------------------------------------------------

    def deliver(self, topic: Heard, key: str, payload: bytes) -> None:
        """See Exchange."""
        if self._dead and self.at in self._dead:
            return
        if not self.faults:
            super().deliver(topic, key, payload)
            return
        sender = self.at
        for subscription in self._subscriptions.reached(key):
            late_ns = self.faults.fate(sender, self._owners.get(subscription.inbox, NOBODY))
            if late_ns is None:
                self.faults.lost += 1
            elif late_ns == 0:
                subscription.inbox.append(subscription.topic, key, payload)
            else:
                self._later(late_ns, _arrival(subscription, key, payload))

    def ask(self, selector: str, payload: bytes, take: Callable[[Answer], None], over: Callable[[], None]) -> None:
        """See Exchange."""
        if self._dead and self.at in self._dead:
            over()
            return
        if not self.faults and not self._asleep and not self._healing:
            super().ask(selector, payload, take, over)
            return
        asker, is_answered = self.at, False
        here: list[_Answerer] = []
        for answer in self._queryables.reached(selector.partition("?")[0]):
            assert isinstance(answer, _Answerer)
            if self._is_unknown(asker, answer.owner):
                continue
            request_ns, reply_ns = self.faults.fate(asker, answer.owner), self.faults.fate(answer.owner, asker)
            request = _request(answer, selector, payload)
            is_answered = True
            if answer.owner in self._asleep:
                if request_ns is not None:
                    self._asleep[answer.owner].append(request)
            elif request_ns is None:
                self.faults.lost += 1
            elif request_ns > 0:
                self._later(request_ns, request)
            elif reply_ns == 0:
                here.append(answer)
            else:
                request()
        if not here:
            if is_answered:
                take(Answer("", ZENOH_TIMEOUT, is_error=True))
            over()
            return
        gathering = Gathering(selector, payload, len(here), take, over)
        for answer in here:
            answer(LocalQuery(gathering))

    def _is_unknown(self, asker: str, owner: str) -> bool:
        """Whether the asker's side of a cut does not have the declarations of the other side."""
        old_ns = self._clock.now_ns() - TOKEN_LEASE_NS
        gone = [cut for cut in self.faults if cut.is_partition and cut.since_ns < old_ns]
        return any(cut.crosses(asker, owner) for cut in (*gone, *self._healing.values()))

    def _later(self, late_ns: int, do: Callable[[], object]) -> None:
        self._number += 1
        heappush(self._late, (self._clock.now_ns() + late_ns, self._number, do))


def _arrival(subscription: Subscription, key: str, payload: bytes) -> Callable[[], object]:
    return lambda: subscription.inbox.append(subscription.topic, key, payload)


def _request(answer: _Answerer, selector: str, payload: bytes) -> Callable[[], None]:
    """A request whose reply reaches no component, including components that have died since."""

    def hand_over() -> None:
        if answer.life == answer.exchange.life_of(answer.owner):
            answer(LocalQuery(Gathering(selector, payload, 1, _drop, _ignore)))

    return hand_over


def _drop(_answer: Answer) -> None:
    """No component waits for it any more."""


def _ignore() -> None:
    """No component waits for the end."""
