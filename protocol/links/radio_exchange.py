"""Delivery between the parties of a lockstep run that are connected by radio, if at all.

A robot is a party, with all its endpoints, and so is the coordinator; see `RadioNetwork`. A message of a party reaches
its own endpoints and those of the infrastructure (arena, recorder, scripts) at once. The network decides when it
reaches other parties:

- A sample on a LATEST or EVERY topic is sent once. On a LOSSLESS topic the sender keeps the last `cache` samples of a
  key that a receiver has missed. It sends them again, in order: at most `RESEND_NS` after a path exists again.
- A token disappears for a party that its owner has not reached for `lost_after_ns`, and comes back with the path.
- A query is answered within the tick if request and reply need no longer than the time limit; otherwise it times out.
  A client that has lost the token of the answering party gets the reply that no participant answered. A reply without a
  waiting caller (`Endpoint.ask_into`) arrives after the sum of both delays.

The process of a party may die or be paused (`drop`, `sleep`), with the radio that it uses.
"""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from heapq import heappop, heappush
from threading import Event, get_ident
from typing import Any, Protocol

import zenoh

from robrain.protocol.answers.asked import Answer, Asked
from robrain.protocol.answers.local_query import Gathering, LocalQuery
from robrain.protocol.border.border import Heard
from robrain.protocol.clock import Clock, to_ns
from robrain.protocol.links.exchange import Exchange
from robrain.protocol.links.inbox import Sample
from robrain.protocol.links.link import Replies, TakeAnswer
from robrain.protocol.links.local_link import DeclaringLink, PartyExchange
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.messages.team.arena_messages import LinkCounters
from robrain.protocol.table.topic import ANSWER_S, Delivery, Topic, Urgency

COORDINATOR = "coordinator"
"""The coordinator's party; robots are parties by their names."""
EVERYWHERE = ""
"""The party of arena, recorder and scripts: no radio is between them and any party."""


class RadioNetwork(Protocol):
    """Decides how far messages of a team get. Times are in nanoseconds of the run's clock, sizes in bytes."""

    counters: LinkCounters
    """Outcome of the messages up to now."""
    parties: Sequence[str]
    """All parties that have a radio."""

    def look(self, now_ns: int, on: Collection[str]) -> bool:
        """Update the places of the parties, and which of them are switched on; returns False if it is not yet time."""

    def reaches(self, speaker: str, hearer: str) -> bool:
        """Whether there is a path from one party to another, by relays or without."""

    def spread(self, speaker: str, hearers: Sequence[str], size: int, now_ns: int) -> dict[str, int]:
        """Send a sample once; returns how long it takes to each hearer that it reaches, and counts the others."""

    def overtakes(self, speaker: str, hearer: str) -> bool:
        """Whether samples from one party to another may overtake earlier ones now."""

    def carry(self, speaker: str, hearer: str, size: int, now_ns: int, limit_ns: int) -> int | None:
        """Send a request or a reply, again if it is lost; returns how long it takes, None if that is over the limit."""


def is_direct(speaker: str, hearer: str) -> bool:
    """Whether no radio is between two parties."""
    return speaker == hearer or EVERYWHERE in (speaker, hearer)


After = Callable[[int, Callable[[], object]], object]
"""Calls a function after this number of nanoseconds."""
Waiting = list[Callable[[], None]]
"""Requests that wait for a party whose process is paused."""


class RadioQuery:
    """A query in flight to the endpoints that answer it, and back.

    Args:
        network: how long request and reply take.
        party: party of the caller.
        now_ns: when.
        limit_ns: time limit for request and reply together.
        take: gets the replies.
        after: delivers a reply that arrives later; None if the asker waits, so that `take` gets it at once.

    """

    def __init__(
        self,
        network: RadioNetwork,
        party: str,
        now_ns: int,
        limit_ns: int,
        take: Callable[[Answer], None],
        after: After | None,
    ) -> None:
        self.is_late = False
        """Whether a request or a reply has not arrived within the limit."""
        self._network = network
        self._party = party
        self._now_ns = now_ns
        self._limit_ns = limit_ns
        self._take = take
        self._after = after

    def ask(
        self,
        selector: str,
        payload: bytes,
        answerers: Iterable[tuple[str, list[Callable[[Asked], None]]]],
        over: Callable[[], None],
        asleep: Mapping[str, Waiting],
    ) -> None:
        """Send the request.

        Args:
            selector: key expression, and parameters behind a `?`.
            payload: the request.
            answerers: parties that answer it, and their answers.
            over: called after the last reply.
            asleep: parties whose process is paused; they get the request when it continues, and reply too late.

        """
        asked = []
        for speaker, answers in answerers:
            self._network.counters.asked += not is_direct(self._party, speaker)
            there_ns = self._carried(self._party, speaker, len(selector) + len(payload), 0)
            if there_ns is None:
                continue
            if speaker in asleep:
                self._is_not_answered()
                asleep[speaker].extend(partial(_hand_over_late, answer, selector, payload) for answer in answers)
            else:
                asked += [(speaker, there_ns, answer) for answer in answers]
        left = len(asked)
        if not left:
            over()

        def one_over() -> None:
            nonlocal left
            left -= 1
            if not left:
                over()

        for speaker, there_ns, answer in asked:
            back = partial(self.reply, speaker, there_ns)
            answer(LocalQuery(Gathering(selector, payload, 1, back, one_over)))

    def reply(self, speaker: str, there_ns: int, answer: Answer) -> None:
        """A party replies to a request that took this long to reach it."""
        took_ns = self._carried(speaker, self._party, len(answer.key) + len(answer.payload), there_ns)
        if took_ns is None:
            return
        if self._after is None or took_ns == 0:
            self._take(answer)
        else:
            self._after(took_ns, partial(self._take, answer))

    def _carried(self, speaker: str, hearer: str, size: int, before_ns: int) -> int | None:
        """How long a request or reply takes, and its predecessor; None if it comes too late."""
        if is_direct(speaker, hearer):
            return 0
        took_ns = self._network.carry(speaker, hearer, size, self._now_ns, self._limit_ns - before_ns)
        if took_ns is None:
            self._is_not_answered()
            return None
        return before_ns + took_ns

    def _is_not_answered(self) -> None:
        self.is_late = True
        self._network.counters.timed_out += 1


def _hand_over_late(answer: Callable[[Asked], None], selector: str, payload: bytes) -> None:
    """Hand over a request of which the asker has given up."""
    answer(LocalQuery(Gathering(selector, payload, 1, _drop, _ignore)))


def _drop(_answer: Answer) -> None:
    """The asker does not wait for it any more."""


def _ignore() -> None:
    """The asker does not wait for the end."""


RESEND_NS = to_ns(0.5)
"""Period in which a receiver finds out which samples of a lossless topic it has missed: Zenoh's heartbeat, see
`ZenohLink`."""
IN_FLIGHT_MAX = 65536
"""Samples and replies in flight; further ones are dropped and counted."""


class _Stream:
    """Samples of one key of a lossless topic that one hearer has missed."""

    def __init__(self, speaker: str, kept: int, retry_ns: int) -> None:
        self.speaker = speaker
        self.samples: deque[Sample] = deque(maxlen=kept)
        self.retry_ns = retry_ns


class RadioExchange(PartyExchange):
    """Decides the receivers of samples, queries and tokens, where the parties of a run have radios.

    It is the infrastructure's own exchange at the same time.

    Args:
        network: the network between the parties.
        clock: of the run.
        lost_after_s: how long a token is seen after its owner's last message.

    """

    def __init__(self, network: RadioNetwork, clock: Clock, lost_after_s: float) -> None:
        super().__init__(EVERYWHERE, self._takers_changed, self._token_anywhere)
        self._network = network
        self._clock = clock
        self._lost_after_ns = to_ns(lost_after_s)
        self._homes: dict[str, PartyExchange] = {EVERYWHERE: self}
        self._takers: dict[str, list[PartyExchange]] = {}
        """Parties that take a key, for those that were put."""
        self._received_ns: dict[tuple[str, str], int] = {}
        """Time when a party (the first) last reached another, while the other counts on it."""
        self._on_path: list[tuple[int, int, Callable[[], object]]] = []
        self._number = 0
        self._last_ns: dict[tuple[str, str], int] = {}
        """When the last sample from one party to another arrives."""
        self._missed: dict[tuple[str, str], _Stream] = {}
        """By key and hearer."""
        self._dead: set[str] = set()
        """Parties whose process has died; their remaining endpoints send nothing any more."""
        self._asleep: dict[str, Waiting] = {}
        """Requests that wait for each party whose process is paused."""

    @classmethod
    def open(cls, session: zenoh.Session, network: RadioNetwork, clock: Clock, lost_after_s: float) -> "RadioExchange":
        """That of a session that no other process can join and on which nothing is declared yet."""
        made = cls(network, clock, lost_after_s)
        cls._of_session[str(session.zid())] = made
        return made

    def join(self, party: str) -> PartyExchange:
        """The exchange of a party that opens an endpoint.

        Raises:
            ValueError: the network does not know the party.

        """
        home = self._homes.get(party)
        if home is None:
            if party not in self._network.parties:
                raise ValueError(f"expected a party with a radio, got {party!r}: {', '.join(self._network.parties)}")
            home = self._homes[party] = PartyExchange(party, self._takers_changed, self._token_anywhere)
        home.links += 1
        if home.links == 1 and party:
            self._look()
            for speaker in self._homes.values():
                self._show(home, speaker)
        return home

    def leave(self, home: PartyExchange) -> None:
        """A party closes an endpoint; with the last one its radio is off, also as a relay."""
        home.links -= 1

    def drop(self, party: str) -> None:
        """A party's process has died: none of its declarations exists any more, and it sends nothing more.

        Messages in flight to it are dropped. Declarations of endpoints of this party stay without effect, also when
        another process is started.
        """
        self._dead.add(party)
        self._asleep.pop(party, None)
        home = self._homes.pop(party, None)
        if home is None:
            return
        for at in [at for at, stream in self._missed.items() if party in (at[1], stream.speaker)]:
            del self._missed[at]
        for pair in [pair for pair in self._received_ns if party in pair]:
            del self._received_ns[pair]
        self._takers.clear()
        for key in sorted(home.own_tokens):
            self._token_anywhere(key)

    def begin_life(self, party: str) -> None:
        """A party's process is started."""
        self._dead.discard(party)

    def sleep(self, party: str) -> None:
        """A party's process is paused: requests to it wait, and their callers get no answer in time."""
        self._asleep.setdefault(party, [])

    def wake(self, party: str) -> None:
        """It continues, and handles the waiting requests."""
        for do in self._asleep.pop(party, ()):
            do()

    def step(self) -> None:
        """Update the reach of all parties, and deliver the messages that have arrived meanwhile."""
        now_ns = self._clock.now_ns()
        self._look()
        while self._on_path and self._on_path[0][0] <= now_ns:
            heappop(self._on_path)[2]()
        for at in [at for at, stream in self._missed.items() if now_ns >= stream.retry_ns]:
            self._send_again(at, self._missed[at], now_ns)

    # -- samples --------------------------------------------------------------------------------------------

    def deliver(self, topic: Heard, key: str, payload: bytes) -> None:
        """Hand a sample of the infrastructure to all subscribers of its key."""
        self.deliver_from(EVERYWHERE, topic, key, payload)

    def deliver_from(self, party: str, topic: Heard, key: str, payload: bytes) -> None:
        """Hand a party's sample to all parties that it reaches."""
        if party in self._dead:
            return
        takers = self._takers.get(key)
        if takers is None:
            takers = self._takers[key] = [home for home in self._homes.values() if home.takes(topic, key)]
        if not takers:
            return
        if get_ident() != self._owner:  # a separate thread, such as a plugin's server: the run is not repeatable
            for home in takers:
                if is_direct(party, home.party) or self._network.reaches(party, home.party):
                    Exchange.deliver(home, topic, key, payload)
            return
        sample: Sample = (topic, key, payload, [])
        far = []
        for home in takers:
            if is_direct(party, home.party):
                home.hand(sample)
            else:
                far.append(home.party)
        if far:
            self._send(party, far, sample)

    def _send(self, speaker: str, hearers: list[str], sample: Sample) -> None:
        now_ns = self._clock.now_ns()
        topic, key = sample[0], sample[1]
        is_kept = isinstance(topic, Topic) and topic.delivery is Delivery.LOSSLESS
        if is_kept and self._missed:
            waiting = [self._missed.get((key, hearer)) for hearer in hearers]
            hearers = [hearer for hearer, stream in zip(hearers, waiting, strict=True) if stream is None]
            for stream in waiting:
                if stream is not None:
                    self._keep(stream, sample)
        took_ns = self._network.spread(speaker, hearers, _size(sample), now_ns)
        for hearer in hearers:
            if hearer in took_ns:
                self._arrive(speaker, hearer, now_ns + took_ns[hearer], sample)
            elif is_kept:
                assert isinstance(topic, Topic)
                stream = self._missed[key, hearer] = _Stream(speaker, topic.cache, now_ns + RESEND_NS)
                self._keep(stream, sample)

    def _keep(self, stream: _Stream, sample: Sample) -> None:
        self._network.counters.outdated += len(stream.samples) == stream.samples.maxlen
        stream.samples.append(sample)

    def _send_again(self, at: tuple[str, str], stream: _Stream, now_ns: int) -> None:
        stream.retry_ns = now_ns + RESEND_NS
        hearer = at[1]
        if not self._homes[stream.speaker].links:
            del self._missed[at]  # with the sender, its stored samples have gone
            return
        if not self._network.reaches(stream.speaker, hearer):
            return
        while stream.samples:
            sample = stream.samples[0]
            took_ns = self._network.spread(stream.speaker, [hearer], _size(sample), now_ns)
            if hearer not in took_ns:
                return
            stream.samples.popleft()
            self._arrive(stream.speaker, hearer, now_ns + took_ns[hearer], sample)
        del self._missed[at]

    def _arrive(self, speaker: str, hearer: str, due_ns: int, sample: Sample) -> None:
        """Hand a sample over when it arrives, after all that the speaker has sent there before."""
        pair = speaker, hearer
        last_ns = self._last_ns.get(pair, 0)
        if due_ns < last_ns and not self._network.overtakes(speaker, hearer):
            due_ns = last_ns
        self._last_ns[pair] = max(due_ns, last_ns)
        self._network.counters.delivered += self._at(due_ns, partial(self._homes[hearer].hand, sample))

    def _at(self, due_ns: int, do: Callable[[], object]) -> bool:
        """Do something now or when it is due; returns False if there is no room for it."""
        if due_ns <= self._clock.now_ns():
            do()
        elif len(self._on_path) >= IN_FLIGHT_MAX:
            self._network.counters.overflowed += 1
            return False
        else:
            self._number += 1
            heappush(self._on_path, (due_ns, self._number, do))
        return True

    def _takers_changed(self) -> None:
        self._takers.clear()

    # -- queries --------------------------------------------------------------------------------------------

    def ask_from(
        self,
        party: str,
        selector: str,
        payload: bytes,
        limit_ns: int,
        take: Callable[[Answer], None],
        over: Callable[[], None],
        *,
        waits: bool,
    ) -> RadioQuery:
        """Send a party's query to all endpoints that answer it, as far as it knows them; as `ask`.

        Args:
            party: party of the caller.
            selector: as for `ask`.
            payload: as for `ask`.
            limit_ns: time limit for request and reply together.
            take: as for `ask`.
            over: as for `ask`.
            waits: whether the asker waits, so that `take` gets each reply now; otherwise when it arrives.

        """
        key = selector.partition("?")[0]
        query = RadioQuery(self._network, party, self._clock.now_ns(), limit_ns, take, None if waits else self._after)
        if party in self._dead:
            over()
            return query
        known = [
            (speaker, answers)
            for speaker, home in self._homes.items()
            if (answers := home.answerers(key)) and (is_direct(party, speaker) or (speaker, party) in self._received_ns)
        ]
        query.ask(selector, payload, known, over, self._asleep)
        return query

    def _after(self, delay_ns: int, do: Callable[[], object]) -> None:
        self._at(self._clock.now_ns() + delay_ns, do)

    # -- tokens ---------------------------------------------------------------------------------------------

    def _look(self) -> None:
        """Update which parties count on each other, from the reach of the network now."""
        now_ns, network, heard_ns = self._clock.now_ns(), self._network, self._received_ns
        homes = [home for party, home in self._homes.items() if party]
        if not network.look(now_ns, [home.party for home in homes if home.links]):
            return
        for speaker in homes:
            for hearer in homes:
                pair = speaker.party, hearer.party
                if speaker is hearer:
                    continue
                if network.reaches(*pair):
                    is_new = pair not in heard_ns
                    heard_ns[pair] = now_ns
                    if is_new:
                        self._show(hearer, speaker)
                elif pair in heard_ns and now_ns - heard_ns[pair] > self._lost_after_ns:
                    del heard_ns[pair]
                    self._show(hearer, speaker)

    def _show(self, hearer: PartyExchange, speaker: PartyExchange) -> None:
        for key in sorted(speaker.own_tokens):
            hearer.show(key, is_there=self._sees(hearer.party, key))

    def _sees(self, hearer: str, key: str) -> bool:
        for speaker, home in self._homes.items():
            is_in_reach = is_direct(speaker, hearer) or (speaker, hearer) in self._received_ns
            if is_in_reach and key in home.own_tokens:
                return True
        return False

    def _token_anywhere(self, key: str) -> None:
        for hearer, home in self._homes.items():
            home.show(key, is_there=self._sees(hearer, key))


def _size(sample: Sample) -> int:
    """Bytes that a sample takes on the air."""
    return len(sample[1]) + len(sample[2])


class LocalRadioLink(DeclaringLink):
    """A `Link` within this process, for one party.

    Args:
        exchange: of the run.
        party: party of the endpoint: a robot's name, `COORDINATOR`, or `EVERYWHERE` for arena, recorder and scripts.

    Raises:
        ValueError: there is no such party.

    """

    def __init__(self, exchange: RadioExchange, party: str) -> None:
        self._party = party
        self._exchange = exchange
        self._home = exchange.join(party)
        super().__init__(self._home)
        self._is_open = True

    def deliver(self, topic: Heard, key: str, payload: bytes) -> None:
        """Send a sample of this party."""
        self._exchange.deliver_from(self._party, topic, key, payload)

    def publisher(self, topic: Topic[Any], key: str, clock: Clock) -> Publisher:
        """See `Link`."""
        return Publisher(topic, key, clock, self)

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
        super().close()
        if self._is_open:
            self._is_open = False
            self._exchange.leave(self._home)
