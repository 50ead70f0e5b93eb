"""A component's place on the wire: it declares, owns and closes everything that the component says and hears.

The same calls serve both drives. In lockstep every callback is direct, so a put is delivered before it returns,
and a query from the runner's own thread is answered there and then; what comes from another process waits for
`serve()`. In live, callbacks run on Zenoh's threads and only append to inboxes.
"""

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from threading import get_ident
from typing import Any

import zenoh
from zenoh import ext

from robrain.protocol.wire.answers.answering import Answering, SharedQueue
from robrain.protocol.wire.answers.later import Later, call_error, read_reply
from robrain.protocol.wire.answers.lockstep_query import NO_LIMIT_S, LockstepReplies, is_from_outside
from robrain.protocol.wire.answers.replying import reply_deferred, reply_error
from robrain.protocol.wire.border.border import Border, Heard
from robrain.protocol.wire.border.codec import BadPayload
from robrain.protocol.wire.border.refusals import RefusalCode, Refusals
from robrain.protocol.wire.clock import Clock
from robrain.protocol.wire.declared_keys import DeclaredKeys
from robrain.protocol.wire.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.wire.exchange import Exchange
from robrain.protocol.wire.inbox import NOTHING, Inbox
from robrain.protocol.wire.keys import check_name
from robrain.protocol.wire.presence import Presence
from robrain.protocol.wire.publisher import PRIORITY, Publisher
from robrain.protocol.wire.serving import Deferred, Drive, Handler, OnOutside, Request, Serve
from robrain.protocol.wire.topic import JSON, Delivery, Q, Query, R, Token, Topic

__all__ = ["Deferred", "Drive", "Endpoint", "Handler", "OnOutside", "Request", "Serve"]

logger = logging.getLogger(__name__)

PENDING_QUERIES = 256
REPLIES = 64
"""Of a channel. A key has one reply, but a full channel would hold up the link, and a ring loses it with the query."""
BY = "by"
CONGESTION = {False: zenoh.CongestionControl.DROP, True: zenoh.CongestionControl.BLOCK}
HISTORY_TIMEOUT_S = 5.0
STUCK_TIMEOUT_S = 2.0
"""How long `close` waits for handlers that are still running."""


_Waiting = tuple[zenoh.Query, Query[Any, Any], str | None, Callable[[Request[Any]], Any]]


class Endpoint:
    """One component on one session.

    Args:
        session: shared in lockstep, one a process in live; not closed by the endpoint.
        team: which team's keys are meant.
        clock: stamps what is sent.
        drive: who moves time.
        on_outside: told of what reached a lockstep run from another process and may have changed it (key, payload),
            as far as it is not on a recorded topic.
        workers: how many queries to one queryable are answered at a time, with Serve.POOL.
        refusals: counts refused messages and requests, where several endpoints are counted together.

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
    ) -> None:
        self.session = session
        self.team = team
        self.clock = clock
        self.drive = drive
        self.refused_queries = 0
        self.refusals = Refusals(clock) if refusals is None else refusals
        """Counts of the messages and requests that the endpoint refused."""
        self._border = Border(clock, self.refusals)
        self._on_outside = on_outside
        self.has_waiting = False
        """Whether `serve` has something to do."""
        self.on_waiting: Callable[[], None] | None = None
        """Called on Zenoh's threads when it has, so that a loop sleeping between two steps can wake up."""
        self.on_heard: Callable[[], None] | None = None
        """Called there when a sample has arrived."""
        self._from_others: deque[tuple[str, bytes]] = deque(maxlen=PENDING_QUERIES)
        self._owner = threading.get_ident()
        self._zid = session.zid()
        self._exchange = Exchange.of(session) if drive is Drive.LOCKSTEP else None
        self._entities: list[Any] = []
        self._declared_keys = DeclaredKeys(session)
        self._pending: deque[_Waiting] = deque()
        self._closing = False
        self._workers = workers
        self._answering: list[Answering[tuple[Any, ...]]] = []
        self._shared: SharedQueue[tuple[Any, ...]] | None = None

    def publisher(self, topic: Topic[Any], **names: str) -> Publisher:
        """A publisher of one concrete key."""
        key = topic.key(self.team, **names)
        options: dict[str, Any] = {
            "encoding": topic.encoding,
            "priority": PRIORITY[topic.urgency],
            "congestion_control": CONGESTION[topic.is_blocking],
            "express": topic.is_blocking,
        }

        def declare() -> Any:
            declared: Any
            if self._exchange is not None:
                declared = self.session.declare_publisher(key, **options, allowed_destination=zenoh.Locality.REMOTE)
            elif topic.delivery is Delivery.LOSSLESS:
                declared = ext.declare_advanced_publisher(
                    self.session,
                    key,
                    **options,
                    cache=ext.CacheConfig(topic.cache),
                    sample_miss_detection=ext.MissDetectionConfig(heartbeat=0.5, sporadic_heartbeat=None),
                    publisher_detection=True,
                )
            else:
                declared = self.session.declare_publisher(key, **options)
            self._entities.append(declared)
            return declared

        return Publisher(declare, topic, key, self.clock, self._entities.remove, self._exchange)

    def token(self, topic: Token, **names: str) -> None:
        """Say that this component is there, for as long as the endpoint is open."""
        self._entities.append(self.session.liveliness().declare_token(topic.key(self.team, **names)))

    # -- hearing --------------------------------------------------------------------------------------------

    def subscribe(self, inbox: Inbox, topic: Topic[Any], **names: str) -> None:
        """Put what arrives on a topic into `inbox`; names that are not given match any."""
        inbox.adopt(self._border)
        key = topic.selector(self.team, **names)
        if self._exchange is not None:
            self._entities.append(self._exchange.subscribe(key, topic, inbox))
        # Where names are left open, each sample says its own; to ask it of others too costs half as much as the rest.
        own_key = key if "*" not in key else None
        lockstep, owner = self.drive is Drive.LOCKSTEP, self._owner
        learns, known = own_key is None and not lockstep, self._declared_keys.keys

        def take(sample: zenoh.Sample) -> None:
            outside = lockstep and get_ident() != owner
            key = own_key or str(sample.key_expr)
            if learns and key not in known:
                self._declared_keys.declared(key)
            payload = sample.payload.to_bytes()
            is_taken = inbox.append(topic, key, payload, outside=outside)
            if self.on_heard is not None:
                self.on_heard()
            if is_taken and outside and not topic.recorded:  # of what is recorded, the recorder itself sees that
                self.note_outside(key, payload)

        if self.drive is Drive.LIVE and topic.delivery is Delivery.LOSSLESS:
            self._entities.append(
                ext.declare_advanced_subscriber(
                    self.session,
                    key,
                    take,
                    history=ext.HistoryConfig(detect_late_publishers=True),
                    recovery=ext.RecoveryConfig(heartbeat=True, periodic_queries=None),
                    subscriber_detection=False,
                )
            )
        else:
            callback = self._callback(take, waits=inbox.acts_at_once or learns)
            self._entities.append(self.session.declare_subscriber(key, callback))

    def watch(self, topic: Token, **names: str) -> Presence:
        """Follow who says to be there on a token's topic, those included who are there already."""
        presence = Presence(topic)
        selector = topic.selector(self.team, **names)
        liveliness = self.session.liveliness()
        lockstep = self.drive is Drive.LOCKSTEP
        self._entities.append(
            liveliness.declare_subscriber(selector, self._callback(presence.append, waits=False), history=not lockstep)
        )
        if lockstep:  # a subscriber's history comes on a thread of Zenoh's even to a direct callback, some time later
            own = LockstepReplies(self._zid)
            liveliness.get(selector, own.handler(), timeout=NO_LIMIT_S)
            own.wait(HISTORY_TIMEOUT_S)
            for reply in own.replies:
                if reply.ok is not None:
                    presence.append(reply.ok)
        return presence

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
        own_key = topic.key(self.team, **names) if set(names) == set(topic.fields) else None
        selector = topic.selector(self.team, **names)
        if self.drive is Drive.LIVE and serve in (Serve.POOL, Serve.SHARED):
            answer_on_threads = self._answer_on_threads if serve is Serve.POOL else self._answer_on_shared_threads
            answer_on_threads(selector, at_once, topic, own_key, handler)
            return

        def take(query: zenoh.Query) -> None:
            waits = serve is Serve.IN_STEP if self.drive is Drive.LIVE else self._from_outside()
            do = self._queue if waits and not self._closing else self._reply
            do(query, topic, own_key, handler)

        callback = self._callback(take, waits=serve is not Serve.IN_STEP)
        self._entities.append(self.session.declare_queryable(selector, callback))

    def _answer_on_threads(self, selector: str, at_once: Sequence[str], *of_query: Any) -> None:
        queryable: Any = self.session.declare_queryable(selector, zenoh.handlers.FifoChannel(PENDING_QUERIES))
        recv = queryable.handler.recv

        def receive() -> tuple[Any, ...] | None:
            try:
                return (at_once, recv(), *of_query)
            except zenoh.ZError:  # undeclared, and nothing waits any more
                return None

        self._entities.append(queryable)
        name = f"answer-{of_query[0].name}"
        self._answering.append(Answering(name, receive, self._answer_one, self._refuse_one, self._workers))

    def _answer_on_shared_threads(self, selector: str, at_once: Sequence[str], *of_query: Any) -> None:
        if self._shared is None:
            self._shared = SharedQueue()
            receive, limit = self._shared.receive, self._workers
            self._answering.append(Answering("answer", receive, self._answer_one, self._refuse_one, limit, 1))
        shared = self._shared

        def take(query: zenoh.Query) -> None:
            if shared.waiting < PENDING_QUERIES:
                shared.put((at_once, query, *of_query))
            else:
                self._refuse(query, f"{PENDING_QUERIES} queries wait already")

        self._entities.append(self.session.declare_queryable(selector, self._callback(take, waits=False)))

    def _answer_one(self, asked: tuple[Any, ...]) -> None:
        self._reply(*asked[1:])

    def _refuse_one(self, asked: tuple[Any, ...]) -> None:
        if self._closing or str(asked[1].key_expr).rpartition("/")[2] in asked[0]:
            self._reply(*asked[1:])
        else:
            self._refuse(asked[1], f"{self._workers} calls are being answered already")

    def serve(self) -> None:
        """Answer the queries that wait for this component's step."""
        self.has_waiting = False
        while self._from_others and self._on_outside is not None:
            self._on_outside(*self._from_others.popleft())
        for _ in range(len(self._pending)):
            query, topic, own_key, handler = self._pending.popleft()
            if self._on_outside is not None and self.drive is Drive.LOCKSTEP and not topic.reads_only:
                payload = query.payload.to_bytes() if query.payload is not None else b""
                self._on_outside(str(query.selector), payload)
            self._reply(query, topic, own_key, handler)

    def note_outside(self, key: str, payload: bytes) -> None:
        """Something from another process reached a lockstep run; passed on at the next `serve()`."""
        self._from_others.append((key, payload))
        self.has_waiting = True

    def _queue(self, *waiting: *_Waiting) -> None:
        if len(self._pending) >= PENDING_QUERIES:
            self._refuse(waiting[0], f"{PENDING_QUERIES} queries wait already")
            return
        self._pending.append(waiting)
        self.has_waiting = True
        if self.on_waiting is not None:
            self.on_waiting()

    def _refuse(self, query: zenoh.Query, why: str) -> None:
        self.refused_queries += 1
        with query:
            reply_error(query, CallError(ErrorCode.BUSY, why))

    def _reply(self, *waiting: *_Waiting) -> None:
        query, topic, own_key, handler = waiting
        is_deferred = False
        try:
            if self._closing:
                raise CallError(ErrorCode.UNLOADED, "the component has stopped")
            key = own_key or str(query.key_expr)
            names = topic.parse(key)
            if names is None:
                raise CallError(ErrorCode.BAD_ARGUMENTS, f"{key}: ask one concrete key")
            payload = query.payload
            asked = self.read_request(topic, key, payload.to_bytes() if payload is not None else b"")
            result = handler(Request(names, asked, query.parameters.get(BY) or ""))
            if isinstance(result, Deferred):
                is_deferred = True
                result.when(partial(reply_deferred, query, key, topic, result.reply))
            else:
                query.reply(key, topic.payloads.write(result), encoding=topic.encoding)
        except CallError as error:
            reply_error(query, error)
        except (Exception, SystemExit) as error:
            # Foreign plugin code may even call exit(), and a query that is not answered reads as "nobody there".
            logger.exception("a handler of %s failed", topic.name)
            reply_error(query, CallError(ErrorCode.FAILED, f"{type(error).__name__}: {error}"))
        finally:
            if not is_deferred:
                query.drop()

    def read_request(self, topic: Query[Q, Any], key: str, payload: bytes) -> Q:
        """Decode a request (CallError if it is refused, which is counted)."""
        try:
            return topic.requests.read(payload)
        except BadPayload as error:
            code = RefusalCode.TOO_LARGE if error.is_too_large else RefusalCode.MALFORMED
            self.refusals.note(topic.name, key, code, str(error))
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
            by: who asks, where that matters: the holder of an exclusive plugin.
            names: the names in the key.

        Raises:
            BadName: a name cannot be one.
            CallError: the reply is an error, does not decode (`failed`), or none came in time (`timeout`).
            NobodyThere: nobody answers that key.
        """
        key = topic.key(self.team, **names)
        body = None if request is None else topic.requests.write(request)
        timeout_s = topic.timeout_s if timeout_s is None else timeout_s
        priority = PRIORITY[topic.urgency]
        selector = f"{key}?{BY}={check_name('asker', by)}" if by else key
        for reply in self._replies(selector, timeout_s, payload=body, encoding=JSON, priority=priority):
            if reply.ok is not None:
                return read_reply(topic, key, reply.ok.payload.to_bytes())
            raise call_error(reply.err)
        raise NobodyThere(f"nobody answers {key}")

    def _replies(self, selector: str, timeout_s: float, **options: Any) -> Iterable[zenoh.Reply]:
        if self.drive is Drive.LIVE:
            replies: Iterable[zenoh.Reply] = self.session.get(selector, timeout=timeout_s, **options)
            return replies
        own = LockstepReplies(self._zid)
        self.session.get(selector, own.handler(), timeout=NO_LIMIT_S, **options)
        in_time = own.wait(timeout_s)
        if own.from_outside:
            self.note_outside(selector, b"")
        if not in_time:
            raise CallError(ErrorCode.TIMEOUT, "no reply in time")
        return own.replies

    def ask_later(
        self, topic: Query[Q, R], request: Q | None = None, *, timeout_s: float | None = None, **names: str
    ) -> Later[R]:
        """Ask one concrete key without waiting; in lockstep the reply is there when this returns.

        Args:
            topic: which query.
            request: None asks without a payload.
            timeout_s: how long a reply is waited for; None for as long as the query says.
            names: the names in the key.

        """
        key = topic.key(self.team, **names)
        if self.drive is Drive.LOCKSTEP:
            try:
                return Later(key, topic, known=[self.ask(topic, request, timeout_s=timeout_s, **names)])
            except (CallError, NobodyThere) as error:
                return Later(key, topic, known=error)
        body = None if request is None else topic.requests.write(request)
        timeout_s = topic.timeout_s if timeout_s is None else timeout_s
        priority = PRIORITY[topic.urgency]
        return Later(key, topic, self._get(key, payload=body, timeout=timeout_s, encoding=JSON, priority=priority))

    def _get(self, key: str, **options: Any) -> Any:
        """Ask in live without waiting; returns the channel of the replies."""
        return self.session.get(self._declared_keys.declared(key), zenoh.handlers.FifoChannel(REPLIES), **options)

    def ask_into(
        self,
        inbox: Inbox,
        topic: Query[Q, Any],
        reply_topic: Heard,
        request: Q | None = None,
        *,
        timeout_s: float | None = None,
        **names: str,
    ) -> None:
        """Ask one concrete key without waiting: the reply arrives in `inbox` as a message of another topic.

        An error, an empty reply (`null`) and silence leave the inbox as it is.

        Args:
            inbox: where the reply goes.
            topic: which query.
            reply_topic: what the reply is taken for; its key is built from the same names.
            request: None asks without a payload.
            timeout_s: how long a reply is waited for; None for as long as the query says.
            names: the names in the key.

        """
        timeout_s = topic.timeout_s if timeout_s is None else timeout_s
        inbox.adopt(self._border)
        key, reply_key = topic.key(self.team, **names), reply_topic.key(self.team, **names)
        body: dict[str, Any] = {} if request is None else {"payload": topic.requests.write(request), "encoding": JSON}
        if self.drive is Drive.LIVE:  # a callback would start a thread for each query
            inbox.expect(self._get(key, timeout=timeout_s, **body), reply_topic, reply_key)
            return

        def take(reply: zenoh.Reply) -> None:
            payload = reply.ok.payload.to_bytes() if reply.ok is not None else NOTHING
            if is_from_outside(reply, self._zid):
                self.note_outside(key, payload)
            if payload != NOTHING:
                inbox.append(reply_topic, reply_key, payload)

        self.session.get(key, self._callback(take), timeout=NO_LIMIT_S, **body)

    def close(self) -> None:
        """Undeclare everything; queries that still wait are answered `unloaded`."""
        self._closing = True
        for entity in reversed(self._entities):
            entity.undeclare()
        self._entities.clear()
        self._declared_keys.undeclare()
        while self._pending:
            self._reply(*self._pending.popleft())
        if self._shared is not None:
            self._shared.end()
            self._shared = None
        for answering in self._answering:  # what waits there is answered `unloaded` as well
            stuck = answering.join(STUCK_TIMEOUT_S)
            if stuck:
                logger.warning("answers that do not come back are left behind: %s", ", ".join(stuck))
        self._answering.clear()

    @property
    def is_closed(self) -> bool:
        """Whether `close` was called, and `reopen` was not since."""
        return self._closing

    def reopen(self) -> None:
        """Use it again after `close`."""
        self._closing = False

    def _from_outside(self) -> bool:
        """In lockstep, whether what is being delivered comes from another process."""
        return self.drive is Drive.LOCKSTEP and threading.get_ident() != self._owner

    def _callback(self, function: Callable[[Any], None], *, waits: bool = True) -> "zenoh.handlers.Callback[Any]":
        """In live, a callback on a thread of its own if it may wait for anything, else on Zenoh's."""
        return zenoh.handlers.Callback(function, indirect=waits and self.drive is Drive.LIVE)
