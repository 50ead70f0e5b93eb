"""The link of an endpoint to its Zenoh session: live, and in a lockstep run that other processes may join."""

from collections.abc import Callable, Iterator
from functools import partial
from threading import Event
from typing import Any

import zenoh
from zenoh import ext

from robrain.protocol.answers.asked import Answer, ZenohQuery, answer_of
from robrain.protocol.border.border import Border
from robrain.protocol.clock import Clock
from robrain.protocol.links.exchange import Exchange
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.links.link import Declaration, OnAnswer, OnChange, OnQuery, OnSample, Replies
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.topic import JSON, Delivery, Topic, Urgency

PRIORITY = {
    Urgency.REAL_TIME: zenoh.Priority.REAL_TIME,
    Urgency.INTERACTIVE_HIGH: zenoh.Priority.INTERACTIVE_HIGH,
    Urgency.DATA_HIGH: zenoh.Priority.DATA_HIGH,
    Urgency.DATA: zenoh.Priority.DATA,
    Urgency.DATA_LOW: zenoh.Priority.DATA_LOW,
    Urgency.BACKGROUND: zenoh.Priority.BACKGROUND,
}
AT_ONCE = frozenset({Urgency.REAL_TIME, Urgency.INTERACTIVE_HIGH})
"""Sent by themselves, not in batches with others: a batch waits for more."""


def publisher_options(topic: Topic[Any]) -> dict[str, Any]:
    """Arguments of Zenoh's publisher of a topic."""
    return {"encoding": topic.encoding, **_options(topic.urgency, waits=topic.is_blocking)}


def query_options(urgency: Urgency) -> dict[str, Any]:
    """Arguments of Zenoh's queries of such urgency: there is one at a time, which is to arrive."""
    return _options(urgency, waits=True)


def _options(urgency: Urgency, *, waits: bool) -> dict[str, Any]:
    control = zenoh.CongestionControl.BLOCK if waits else zenoh.CongestionControl.DROP
    return {"priority": PRIORITY[urgency], "congestion_control": control, "express": urgency in AT_ONCE}


DECLARED_KEYS = 16384
"""Maximum number of declared keys of one endpoint; further keys are used undeclared."""


class DeclaredKeys:
    """The keys that one endpoint has declared.

    A session that subscribes to tokens compares each undeclared key with all tokens, each time. With a thousand robots
    that takes 60 µs for a sample and 430 µs for a query, instead of 8 and 50 µs.

    Args:
        session: that the keys are declared to.

    """

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._is_closed = False
        self.keys: dict[str, zenoh.KeyExpr] = {}

    def declared(self, key: str) -> zenoh.KeyExpr | str:
        """The key to use; it is declared if there is room, and the session is open."""
        if key not in self.keys and len(self.keys) < DECLARED_KEYS and not self._is_closed:
            try:
                self.keys[key] = self._session.declare_keyexpr(key)
            except zenoh.ZError:  # a sample arrives on Zenoh's thread while the session closes
                return key
        return self.keys.get(key, key)

    def undeclare(self) -> None:
        """Undeclare all."""
        self._is_closed = True
        while self.keys:
            self._session.undeclare(self.keys.popitem()[1])


SENDERS_MAX = 4096
"""Senders whose keys are kept; lost samples of other senders are counted under the selector."""


class LostSamples:
    """Follows one subscription; called on Zenoh's threads.

    Args:
        topic: topic of the subscription.
        selector: the keys that are subscribed to.
        border: counts losses.

    """

    def __init__(self, topic: Topic[Any], selector: str, border: Border) -> None:
        self._topic = topic
        self._selector = selector
        self._border = border
        self._keys: dict[tuple[str, int], str] = {}

    def record_sender(self, sample: zenoh.Sample, key: str) -> None:
        """Remember the owner of a key: a miss names its publisher only."""
        source = sample.source_info
        if source is not None and len(self._keys) < SENDERS_MAX:
            self._keys[_publisher(source.source_id)] = key

    def missed(self, miss: ext.Miss) -> None:
        """Count samples of a publisher that no recovery has brought."""
        key = self._keys.get(_publisher(miss.source), self._selector)
        self._border.record_lost(self._topic, key, miss.nb)


def _publisher(source: zenoh.EntityGlobalId) -> tuple[str, int]:
    return str(source.zid), source.eid


NO_LIMIT_S = 1e9
"""Time limit of queries of a lockstep run, which never ends one.

Zenoh applies a limit by the wall clock, on a separate thread. It would drop the reply of a slow handler, or after a
pause of the process, and the run would depend on the machine. Zenoh requires a number, and keeps about 650 bytes per
query until the session is closed. `LockstepReplies.wait` has a limit for replies from other processes alone.
"""


def is_from_outside(reply: zenoh.Reply, own: zenoh.ZenohId) -> bool:
    """Whether another process sent a reply; `own` is the id of this process's session.

    The thread does not show it: the last to answer delivers all replies, and that may be the caller itself.
    """
    return reply.replier_id is None or reply.replier_id.zid != own


class LockstepReplies:
    """Collects the replies to one query; pass `handler()` to Zenoh's `get`.

    Args:
        own: id of the session that asks.

    """

    def __init__(self, own: zenoh.ZenohId) -> None:
        self.replies: list[zenoh.Reply] = []
        self._own = own
        self.from_outside = False
        """Whether another process has answered, or failed to in time."""
        self._is_over = Event()

    def handler(self) -> "zenoh.handlers.Callback[Any]":
        """A callback that stores replies, on any thread that delivers them."""
        return zenoh.handlers.Callback(self._handle, self._is_over.set, indirect=False)

    def wait(self, outside_s: float) -> bool:
        """Call after `get`: wait at most this long for other processes, if any were asked; False if none replies."""
        if self.replies or self._is_over.wait(outside_s):
            return True
        self.from_outside = True
        return False

    def _handle(self, reply: zenoh.Reply) -> None:
        if is_from_outside(reply, self._own):
            self.from_outside = True
        self.replies.append(reply)
        self._is_over.set()


HISTORY_TIMEOUT_S = 5.0


class ZenohLink:
    """A `Link` by Zenoh.

    Args:
        session: not closed by the link.
        exchange: delivers puts within a lockstep run; None in live.

    """

    def __init__(self, session: zenoh.Session, exchange: Exchange | None) -> None:
        self.declarations: list[Declaration] = []
        self._session = session
        self._exchange = exchange
        self._zid = session.zid()

    def publisher(self, topic: Topic[Any], key: str, clock: Clock) -> Publisher:
        """See `Link`."""
        options = publisher_options(topic)

        def declare() -> Any:
            declared: Any
            if self._exchange is not None:
                declared = self._session.declare_publisher(key, **options, allowed_destination=zenoh.Locality.REMOTE)
            elif topic.delivery is Delivery.LOSSLESS:
                declared = ext.declare_advanced_publisher(
                    self._session,
                    key,
                    **options,
                    cache=ext.CacheConfig(topic.cache),
                    sample_miss_detection=ext.MissDetectionConfig(heartbeat=0.5, sporadic_heartbeat=None),
                    publisher_detection=True,
                )
            else:
                declared = self._session.declare_publisher(key, **options)
            self.declarations.append(declared)
            return declared

        deliver = None if self._exchange is None else partial(self._exchange.deliver, self._exchange.infrastructure)
        return Publisher(topic, key, clock, deliver, declare, self.declarations.remove)

    def subscribe(self, selector: str, topic: Topic[Any], inbox: Inbox, handle: OnSample, *, waits: bool) -> None:
        """See `Link`."""
        # Where names are left open, each sample carries its own; a query to others too costs half as much as the rest.
        own_key = selector if "*" not in selector else None

        lost: LostSamples | None = None

        def receive(sample: zenoh.Sample) -> None:
            key = own_key or str(sample.key_expr)
            if lost is not None:
                lost.record_sender(sample, key)
            handle(key, sample.payload.to_bytes())

        if self._exchange is not None:
            self.declarations.append(self._exchange.subscribe(selector, topic, inbox, self._exchange.infrastructure))
        declared: Any
        if self._exchange is None and topic.delivery is Delivery.LOSSLESS:
            lost = LostSamples(topic, selector, inbox.border)
            declared = ext.declare_advanced_subscriber(
                self._session,
                selector,
                receive,
                history=ext.HistoryConfig(detect_late_publishers=True),
                recovery=ext.RecoveryConfig(heartbeat=True, periodic_queries=None),
                subscriber_detection=False,
            )
        else:
            declared = self._session.declare_subscriber(selector, self._callback(receive, waits=waits))
        self.declarations.append(declared)
        if lost is not None:
            self.declarations.append(declared.sample_miss_listener(self._callback(lost.missed, waits=False)))

    def queryable(self, selector: str, handle: OnQuery, *, waits: bool) -> None:
        """See `Link`."""
        callback = self._callback(lambda query: handle(ZenohQuery(query)), waits=waits)
        self.declarations.append(self._session.declare_queryable(selector, callback))

    def token(self, key: str) -> None:
        """See `Link`."""
        self.declarations.append(self._session.liveliness().declare_token(key))

    def watch(self, selector: str, handle: OnChange) -> None:
        """See `Link`."""
        liveliness, is_lockstep = self._session.liveliness(), self._exchange is not None

        def changed(sample: zenoh.Sample) -> None:
            handle(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        callback = self._callback(changed, waits=False)
        self.declarations.append(liveliness.declare_subscriber(selector, callback, history=not is_lockstep))
        if (
            is_lockstep
        ):  # a subscriber's history comes on a thread of Zenoh's even to a direct callback, some time later
            own = LockstepReplies(self._zid)
            liveliness.get(selector, own.handler(), timeout=NO_LIMIT_S)
            own.wait(HISTORY_TIMEOUT_S)
            for reply in own.replies:
                if reply.ok is not None:
                    changed(reply.ok)

    def tokens(self, selector: str, timeout_s: float) -> list[str]:
        """See `Link`."""
        replies = self._session.liveliness().get(selector, timeout=timeout_s)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]

    def ask(self, selector: str, payload: bytes | None, urgency: Urgency, timeout_s: float) -> Replies:
        """See `Link`."""
        options: dict[str, Any] = {"payload": payload, "encoding": JSON, **query_options(urgency)}
        if self._exchange is None:
            return Replies(_answers(self._session.get(selector, timeout=timeout_s, **options)))
        own = LockstepReplies(self._zid)
        self._session.get(selector, own.handler(), timeout=NO_LIMIT_S, **options)
        in_time = own.wait(timeout_s)
        return Replies(_answers(own.replies), in_time, own.from_outside)

    def ask_then(self, key: str, payload: bytes | None, handle: OnAnswer) -> None:
        """See `Link`."""
        options: dict[str, Any] = {} if payload is None else {"payload": payload, "encoding": JSON}
        callback = self._callback(
            lambda reply: handle(answer_of(reply, from_outside=is_from_outside(reply, self._zid))), waits=False
        )
        self._session.get(key, callback, timeout=NO_LIMIT_S, **options)

    def close(self) -> None:
        """See `Link`."""
        while self.declarations:
            self.declarations.pop().undeclare()

    def _callback(self, function: Callable[[Any], None], *, waits: bool) -> "zenoh.handlers.Callback[Any]":
        """In live, a callback on a separate thread if it may wait, else on Zenoh's."""
        return zenoh.handlers.Callback(function, indirect=waits and self._exchange is None)


def _answers(replies: Any) -> Iterator[Answer]:
    for reply in replies:
        yield answer_of(reply)
