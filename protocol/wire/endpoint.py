"""A component's access to the wire: it declares, owns and closes all wire objects of the component.

The same calls serve both drives. In lockstep every callback is direct: a put is delivered before it returns. A query
from the runner's own thread is answered within the call. A message from another process waits for `serve()`. In live,
callbacks run on Zenoh's threads and only append to inboxes.
"""

import logging
import threading
from collections import deque
from collections.abc import Callable, Sequence
from enum import StrEnum
from functools import partial
from threading import get_ident
from typing import Any, Generic, NamedTuple

import zenoh

from robrain.protocol.access.identity import member_on
from robrain.protocol.access.member import Member
from robrain.protocol.access.signing import (
    Signing,
    is_signed,
    message_in_own_name,
    read_signed,
    vouch_message,
    vouch_request,
)
from robrain.protocol.answers.answering import Answering, SharedQueue, WaitingQueries, reply_deferred
from robrain.protocol.answers.asked import BY, Answer, Asked, ZenohQuery
from robrain.protocol.answers.later import Later, read_answer
from robrain.protocol.border.border import Border, Incoming
from robrain.protocol.clock import Clock
from robrain.protocol.codec import BadPayload
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere, WireError
from robrain.protocol.keys import check_name
from robrain.protocol.links.exchange import EVERYWHERE, Exchange
from robrain.protocol.links.inbox import NOTHING, Inbox
from robrain.protocol.links.link import Link
from robrain.protocol.links.local_link import LocalLink
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.links.thinning import Thinning
from robrain.protocol.links.zenoh_link import DeclaredKeys, ZenohLink, query_options
from robrain.protocol.refusals import RefusalCode, Refusals
from robrain.protocol.topic import JSON, Q, Query, R, Token, Topic
from robrain.protocol.wire.presence import Presence

logger = logging.getLogger(__name__)

PENDING_QUERIES = 256
REPLIES = 64
"""Of a channel. A key has one reply, but a full channel would hold up the link, and a ring loses it with the query."""
TOKENS_TIMEOUT_S = 10.0
"""Time limit for a hub's list of tokens, which is immediate unless its machine is overloaded."""
STUCK_TIMEOUT_S = 2.0
"""How long `close` waits for handlers that are still running."""

OnOutside = Callable[[str, bytes], None]


class Drive(StrEnum):
    """Source of time: the wall clock, or the lockstep runner."""

    LIVE = "live"
    LOCKSTEP = "lockstep"


class Serve(StrEnum):
    """Where queries are answered in the live drive."""

    AT_ONCE = "at_once"
    """On the thread that Zenoh gives the queryable; one after another."""
    SHARED = "shared"
    """As POOL, on threads that the endpoint's queries of this kind share: for rare queries."""
    POOL = "pool"
    """On separate threads, several at a time; `busy` when there are too many."""
    IN_STEP = "in_step"
    """When the component calls `serve()`."""


class Request(NamedTuple, Generic[Q]):
    """A query as its handler sees it."""

    names: dict[str, str]
    """Names in the key, and its team under `team`."""
    asked: Q
    """The request, decoded; bytes where the query has free JSON, None where it has none."""
    by: str = ""
    """Name of the caller, if it is stated: the parameter `by` of the selector, as in
    `robrain/t/robot/r1/call/p/f?by=ann`. In a secured team the member whom the router's rules vouch for, such as
    `operator:ann`."""
    asker: Member | None = None
    """That member; None where the team is not secured, and `by` is a claim."""


class Deferred(NamedTuple, Generic[R]):
    """A reply that is sent later, so that nothing else waits for its conditions."""

    when: Callable[[Callable[[R | CallError], None]], None]
    """Accepts a function that must be called once, on any thread, with the reply or the error to send instead."""


Handler = Callable[[Request[Q]], R | bytes | Deferred[R]]
"""Returns the reply (bytes go as they are), or raises CallError."""

_Waiting = tuple[Asked, Query[Any, Any], str | None, Callable[[Request[Any]], Any]]


class Endpoint:
    """One component on one session.

    Args:
        session: shared in lockstep, one a process in live; not closed by the endpoint.
        team: team whose keys are used.
        clock: stamps the messages that are sent.
        drive: source of time.
        on_outside: called with each input (key, payload) of a lockstep run from another process that may have changed
            it, unless a recorded topic has it.
        workers: how many queries to one queryable are answered at a time, with Serve.POOL.
        refusals: counts refused messages and requests, where several endpoints are counted together.
        party: owner, for the network that a lockstep run simulates: a robot's name, `COORDINATOR`, or `EVERYWHERE`,
            which receives everything.
        thinning: drops telemetry that the link has no room for; None sends everything.

    """

    def __init__(
        self,
        session: zenoh.Session,
        team: str,
        clock: Clock,
        drive: Drive,
        *,
        on_outside: OnOutside | None = None,
        workers: int = 16,
        refusals: Refusals | None = None,
        party: str = EVERYWHERE,
        thinning: Thinning | None = None,
    ) -> None:
        self.session = session
        self.team = team
        self.clock = clock
        self.drive = drive
        self.member = member_on(session)
        """Member that the session's certificate names; None where the team is not secured."""
        if self.member is not None and self.member.team != team:
            raise WireError(f"the certificate of {self.member} is of team {self.member.team}, not of team {team}")
        self._signing = Signing(self.member)
        self.refusals = Refusals(clock) if refusals is None else refusals
        """Counts of the messages and requests that the endpoint refused."""
        self._border = Border(clock, self.refusals)
        self._thinning = thinning
        self._on_outside = on_outside
        self.has_waiting = False
        """Whether `serve` has something to do."""
        self.on_waiting: Callable[[], None] | None = None
        """Called on Zenoh's threads when it has, so that a loop sleeping between two steps can wake up."""
        self.on_receive: Callable[[], None] | None = None
        """Called there when a sample has arrived."""
        self._from_others: deque[tuple[str, bytes]] = deque(maxlen=PENDING_QUERIES)
        self._owner = threading.get_ident()
        self._link = _link(session, drive, party)
        self._declared_keys = DeclaredKeys(session)
        self._pending: WaitingQueries[_Waiting] = WaitingQueries(PENDING_QUERIES)
        self._closing = False
        self._workers = workers
        self._answering: list[Answering[tuple[Any, ...]]] = []
        self._shared: SharedQueue[tuple[Any, ...]] | None = None

    def publisher(self, topic: Topic[Any], **names: str) -> Publisher:
        """A publisher of one concrete key."""
        publisher = self._link.publisher(topic, self._signing.own(topic, topic.key(self.team, **names)), self.clock)
        publisher.thinning = self._thinning
        if self.member is not None and is_signed(topic):
            publisher.in_own_name = partial(message_in_own_name, topic, member=self.member)
        return publisher

    def token(self, topic: Token, **names: str) -> None:
        """Declare that this component is present, while the endpoint is open."""
        self._link.token(topic.key(self.team, **names))

    # -- hearing --------------------------------------------------------------------------------------------

    def subscribe(self, inbox: Inbox, topic: Topic[Any], **names: str) -> None:
        """Put arrivals on a topic into `inbox`; names that are not given match any."""
        inbox.adopt(self._border)
        selector = self._signing.of_all(topic, topic.selector(self.team, **names))
        lockstep, owner = self.drive is Drive.LOCKSTEP, self._owner
        learns, known = "*" in selector and not lockstep, self._declared_keys.keys
        is_vouched = self._signing.covers(topic)

        def handle(key: str, payload: bytes) -> None:
            outside = lockstep and get_ident() != owner
            if learns and key not in known:
                self._declared_keys.declared(key)
            if is_vouched:
                vouched = vouch_message(topic, key, payload, self.refusals)
                if vouched is None:
                    return
                key, payload = vouched
            is_added = inbox.append(topic, key, payload, outside=outside)
            if self.on_receive is not None:
                self.on_receive()
            if is_added and outside and not topic.recorded:  # the recorder itself sees recorded topics
                self.record_outside(key, payload)

        self._link.subscribe(selector, topic, inbox, handle, waits=inbox.acts_at_once or learns)

    def watch(self, topic: Token, **names: str) -> Presence:
        """Follow the owners of a token's topic, including those that are present already."""
        presence = Presence(topic)
        self._link.watch(topic.selector(self.team, **names), presence.append)
        return presence

    def present(
        self, topic: Token, *, every_team: bool = False, timeout_s: float = TOKENS_TIMEOUT_S
    ) -> list[dict[str, str]]:
        """The names, and the team under `team`, in all tokens of a topic that are there now."""
        selector = topic.of_every_team() if every_team else topic.selector(self.team)
        found = map(topic.parse, self._link.tokens(selector, timeout_s))
        return [names for names in found if names is not None]

    # -- being asked ----------------------------------------------------------------------------------------

    def answer(
        self,
        topic: Query[Q, R],
        handler: Handler[Q, R],
        *,
        serve: Serve = Serve.AT_ONCE,
        at_once: Sequence[str] = (),
        **names: str,
    ) -> None:
        """Answer queries. Every one gets a reply: the handler's result or an ErrorReply.

        A request that is too large, does not decode or is out of range is refused and counted; no handler sees it.

        Args:
            topic: which queries.
            handler: makes the answer.
            serve: where it does, in live.
            at_once: last chunks of keys that are answered even when too many others are.
            names: names in the key; those that are not given match any.

        """
        is_own = set(names) == set(topic.fields) and not self._signing.covers(topic)
        own_key = topic.key(self.team, **names) if is_own else None
        selector = self._signing.of_all(topic, topic.selector(self.team, **names))
        if self.drive is Drive.LIVE and serve in (Serve.POOL, Serve.SHARED):
            answer_on_threads = self._answer_on_threads if serve is Serve.POOL else self._answer_on_shared_threads
            answer_on_threads(selector, at_once, topic, own_key, handler)
            return

        def handle(query: Asked) -> None:
            waits = serve is Serve.IN_STEP if self.drive is Drive.LIVE else self._from_outside()
            do = self._queue if waits and not self._closing else self._reply
            do(query, topic, own_key, handler)

        self._link.queryable(selector, handle, waits=serve is not Serve.IN_STEP)

    def _answer_on_threads(self, selector: str, at_once: Sequence[str], *of_query: Any) -> None:
        queryable: Any = self.session.declare_queryable(selector, zenoh.handlers.FifoChannel(PENDING_QUERIES))
        recv = queryable.handler.recv

        def receive() -> tuple[Any, ...] | None:
            try:
                return (at_once, ZenohQuery(recv()), *of_query)
            except zenoh.ZError:  # undeclared, and nothing waits any more
                return None

        self._link.declarations.append(queryable)
        name = f"answer-{of_query[0].name}"
        self._answering.append(Answering(name, receive, self._answer_one, self._refuse_one, self._workers))

    def _answer_on_shared_threads(self, selector: str, at_once: Sequence[str], *of_query: Any) -> None:
        if self._shared is None:
            self._shared = SharedQueue()
            receive, limit = self._shared.receive, self._workers
            self._answering.append(Answering("answer", receive, self._answer_one, self._refuse_one, limit, 1))
        shared = self._shared

        def handle(query: Asked) -> None:
            if shared.waiting < PENDING_QUERIES:
                shared.put((at_once, query, *of_query))
            else:
                self._refuse(query, f"{PENDING_QUERIES} queries wait already")

        self._link.queryable(selector, handle, waits=False)

    def _answer_one(self, asked: tuple[Any, ...]) -> None:
        self._reply(*asked[1:])

    def _refuse_one(self, asked: tuple[Any, ...]) -> None:
        if self._closing or asked[1].key.rpartition("/")[2] in asked[0]:
            self._reply(*asked[1:])
        else:
            self._refuse(asked[1], f"{self._workers} calls are being answered already")

    def serve(self) -> None:
        """Answer the queries that wait for this component's step."""
        self.has_waiting = False
        while self._from_others and self._on_outside is not None:
            self._on_outside(*self._from_others.popleft())
        for _ in range(len(self._pending)):
            if (waiting := self._pending.pop()) is None:
                break
            query, topic = waiting[:2]
            if self._on_outside is not None and self.drive is Drive.LOCKSTEP and not topic.reads_only:
                self._on_outside(query.selector, query.payload)
            self._reply(*waiting)

    def record_outside(self, key: str, payload: bytes) -> None:
        """Something from another process reached a lockstep run; passed on at the next `serve()`."""
        self._from_others.append((key, payload))
        self.has_waiting = True

    def _queue(self, *waiting: *_Waiting) -> None:
        signed = read_signed(waiting[0].key) if self._signing.covers(waiting[1]) else None
        refused = self._pending.put("" if signed is None else str(signed.asker), waiting)
        self.has_waiting = True
        if self.on_waiting is not None:
            self.on_waiting()
        if refused is not None:
            self._refuse(refused[0], f"{PENDING_QUERIES} queries wait already")

    def _refuse(self, query: Asked, why: str) -> None:
        try:
            query.reply_error(CallError(ErrorCode.BUSY, why))
        finally:
            query.end()

    def _reply(self, *waiting: *_Waiting) -> None:
        query, topic, own_key, handler = waiting
        is_deferred = False
        try:
            if self._closing:
                raise CallError(ErrorCode.UNLOADED, "the component has stopped")
            key = own_key or query.key
            signed_key = read_signed(key) if self._signing.covers(topic) else None
            if signed_key is None and self._signing.covers(topic):
                raise CallError(ErrorCode.FORBIDDEN, f"{key}: in a secured team this is asked under as/ROLE/NAME")
            names = topic.parse(key if signed_key is None else signed_key.key)
            if names is None:
                raise CallError(ErrorCode.BAD_ARGUMENTS, f"{key}: ask one concrete key")
            asked = self.read_request(topic, key, query.payload)
            if signed_key is None:
                request = Request(names, asked, query.by)
            else:
                asker = signed_key.asker
                asked = vouch_request(topic, key, asked, asker, self.refusals)
                request = Request(names, asked, str(asker), asker)
            result = handler(request)
            if isinstance(result, Deferred):
                is_deferred = True
                result.when(partial(reply_deferred, query, key, topic))
            else:
                query.reply(key, topic.payloads.write(result), topic.encoding)
        except CallError as error:
            query.reply_error(error)
        except (Exception, SystemExit) as error:
            # Foreign plugin code may even call exit(), and a query that is not answered reads as "no participant".
            logger.exception("a handler of %s failed", topic.name)
            query.reply_error(CallError(ErrorCode.FAILED, f"{type(error).__name__}: {error}"))
        finally:
            if not is_deferred:
                query.end()

    def read_request(self, topic: Query[Q, Any], key: str, payload: bytes) -> Q:
        """Decode a request (CallError if it is refused, which is counted)."""
        try:
            return topic.requests.read(payload)
        except BadPayload as error:
            code = RefusalCode.TOO_LARGE if error.is_too_large else RefusalCode.MALFORMED
            self.refusals.record(topic.name, key, code, str(error))
            raise CallError(ErrorCode.BAD_ARGUMENTS, str(error)) from error

    # -- asking ---------------------------------------------------------------------------------------------

    def ask(
        self,
        topic: Query[Q, R],
        request: Q | None = None,
        *,
        timeout_s: float | None = None,
        by: str = "",
        **names: str,
    ) -> R:
        """Ask one concrete key and return the reply.

        Args:
            topic: which query.
            request: None asks without a payload.
            timeout_s: time limit for the reply, None for that of the query; in lockstep it applies only to replies
                from other processes.
            by: name of the caller, where that matters: the holder of an exclusive plugin.
            names: the names in the key.

        Raises:
            BadName: a name cannot be one.
            CallError: the reply is an error, does not decode (`failed`), or none came in time (`timeout`).
            NobodyThere: no participant answers that key.
        """
        plain_key = topic.key(self.team, **names)
        key = self._signing.own(topic, plain_key)
        body = self._signing.body(topic, request)
        timeout_s = topic.timeout_s if timeout_s is None else timeout_s
        selector = key
        if by and not self._signing.covers(topic):
            for part in by.split(":"):  # ROLE:NAME
                check_name("asker", part)
            selector = f"{key}?{BY}={by}"
        replies = self._link.ask(selector, body, topic.urgency, timeout_s)
        if replies.from_outside:
            self.record_outside(selector, b"")
        if not replies.in_time:
            raise CallError(ErrorCode.TIMEOUT, "no reply in time")
        for answer in replies.answers:
            return read_answer(topic, plain_key, answer)
        raise NobodyThere(f"nobody answers {plain_key}")

    def ask_later(
        self,
        topic: Query[Q, R],
        request: Q | None = None,
        *,
        timeout_s: float | None = None,
        **names: str,
    ) -> Later[R]:
        """Ask one concrete key without waiting; in lockstep the reply is there when this returns.

        Args:
            topic: which query.
            request: None asks without a payload.
            timeout_s: time limit for a reply; None for the limit of the query.
            names: the names in the key.

        """
        plain_key = topic.key(self.team, **names)
        if self.drive is Drive.LOCKSTEP:
            try:
                return Later(plain_key, topic, known=[self.ask(topic, request, timeout_s=timeout_s, **names)])
            except (CallError, NobodyThere) as error:
                return Later(plain_key, topic, known=error)
        body = self._signing.body(topic, request)
        timeout_s = topic.timeout_s if timeout_s is None else timeout_s
        options = {"payload": body, "encoding": JSON, **query_options(topic.urgency)}
        key = self._signing.own(topic, plain_key)
        return Later(plain_key, topic, self._get(key, timeout=timeout_s, **options))

    def _get(self, key: str, **options: Any) -> Any:
        """Ask in live without waiting; returns the channel of the replies."""
        return self.session.get(self._declared_keys.declared(key), zenoh.handlers.FifoChannel(REPLIES), **options)

    def ask_into(
        self,
        inbox: Inbox,
        topic: Query[Q, Any],
        reply_topic: Incoming,
        request: Q | None = None,
        *,
        timeout_s: float | None = None,
        **names: str,
    ) -> None:
        """Ask one concrete key without waiting: the reply arrives in `inbox` as a message of another topic.

        An empty reply (`null`) leaves the inbox as it is; live, silence and errors are asked again a few times.

        Args:
            inbox: where the reply goes.
            topic: which query.
            reply_topic: topic that the reply is read as; its key is built from the same names.
            request: None asks without a payload.
            timeout_s: time limit for a reply; None for the limit of the query.
            names: the names in the key.

        """
        timeout_s = topic.timeout_s if timeout_s is None else timeout_s
        inbox.adopt(self._border)
        key, reply_key = self._signing.own(topic, topic.key(self.team, **names)), reply_topic.key(self.team, **names)
        body = self._signing.body(topic, request)
        if self.drive is Drive.LIVE:  # a callback would start a thread for each query
            options: dict[str, Any] = {} if body is None else {"payload": body, "encoding": JSON}
            options |= query_options(topic.urgency)
            inbox.expect(lambda: self._get(key, timeout=timeout_s, **options), reply_topic, reply_key)
            return

        def handle(answer: Answer) -> None:
            payload = NOTHING if answer.is_error else answer.payload
            if answer.from_outside:
                self.record_outside(key, payload)
            if payload != NOTHING:
                inbox.append(reply_topic, reply_key, payload)

        self._link.ask_then(key, body, handle)

    def close(self) -> None:
        """Undeclare everything; queries that still wait are answered `unloaded`."""
        self._closing = True
        self._link.close()
        self._declared_keys.undeclare()
        while (waiting := self._pending.pop()) is not None:
            self._reply(*waiting)
        if self._shared is not None:
            self._shared.end()
            self._shared = None
        for answering in self._answering:  # requests that wait there are answered `unloaded` as well
            answering.close(STUCK_TIMEOUT_S)
        self._answering.clear()

    @property
    def is_closed(self) -> bool:
        """Whether `close` was called."""
        return self._closing

    def _from_outside(self) -> bool:
        """In lockstep, whether the current message comes from another process."""
        return self.drive is Drive.LOCKSTEP and threading.get_ident() != self._owner


def _link(session: zenoh.Session, drive: Drive, party: str) -> Link:
    """Carrier of an endpoint's puts, queries and tokens."""
    if drive is Drive.LIVE:
        return ZenohLink(session, None)
    exchange = Exchange.of(session)
    return LocalLink(exchange, party) if exchange.is_alone else ZenohLink(session, exchange)
