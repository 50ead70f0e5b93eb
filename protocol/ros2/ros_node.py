"""A node of ROS 2 over an existing Zenoh session, as `rmw_zenoh` sees it.

The attachment of messages, requests and responses has 33 bytes. These are number and time, two little-endian int64, and
16 bytes of gid behind their length, as Zenoh's serializer writes an array. A server is a queryable, a request a query.
Nodes find each other by liveliness tokens: `@ros2_lv/DOMAIN/SESSION/NODE/ENTITY/KIND/ENCLAVE/NAMESPACE/NAME`, and for
all but nodes `/TOPIC/TYPE/HASH/QOS` (rmw_zenoh: design.md, liveliness_utils.cpp).
"""

from __future__ import annotations

import itertools
import struct
import threading
from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from enum import StrEnum
from typing import Any, Generic, TypeVar

import msgspec
import xxhash
import zenoh
import zenoh.ext

from robrain.protocol.ros2.errors import BadAttachment, BadCdr
from robrain.protocol.ros2.message_types import MessageType, ServiceType
from robrain.protocol.ros2.qos import RELIABLE, History, Qos, Reliability
from robrain.protocol.ros2.ros_names import (
    check_domain,
    check_namespace,
    check_node_name,
    data_key,
    dds_type,
    full_name,
)
from robrain.protocol.ros2.ros_port import ReceivedMessage

M = TypeVar("M")
Q = TypeVar("Q")
R = TypeVar("R")


class EntityKind(StrEnum):
    """Subject of a token."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVER = "SS"
    CLIENT = "SC"


class NodeId(msgspec.Struct, frozen=True):
    """A node."""

    domain: int
    session: str
    """Id of its Zenoh session."""
    number: int
    """Unique in its session."""
    namespace: str
    name: str


class Entity(msgspec.Struct, frozen=True):
    """A node (without the last four), or something that it has."""

    kind: EntityKind
    node: NodeId
    number: int
    """Unique in its session; a node's own number for a node."""
    name: str = ""
    """Of the topic or service."""
    type_name: str = ""
    type_hash: str = ""
    qos: Qos = Qos()

    @property
    def token(self) -> str:
        """Key of its token."""
        node = self.node
        parts = ["@ros2_lv", str(check_domain(node.domain)), node.session, str(node.number), str(self.number)]
        parts += [self.kind, "%", node.namespace.replace("/", "%"), node.name]
        if self.kind is not EntityKind.NODE:
            parts += [self.name.replace("/", "%"), dds_type(self.type_name), self.type_hash, self.qos.token]
        return "/".join(parts)

    @property
    def key(self) -> str:
        """Key of its messages or requests."""
        return data_key(self.node.domain, self.name, self.type_name, self.type_hash)

    @property
    def gid(self) -> bytes:
        """Its id in attachments: XXH3 of the token, as rmw_zenoh derives it."""
        return xxhash.xxh3_128_intdigest(self.token.encode()).to_bytes(16, "little")


GID_BYTES = 16
_FORMAT = struct.Struct(f"<qqB{GID_BYTES}s")


class Attachment(msgspec.Struct, frozen=True):
    """Sender, number and time of a message.

    >>> Attachment.unpack(Attachment(1, 2, bytes(range(16))).pack()).gid.hex()
    '000102030405060708090a0b0c0d0e0f'
    """

    number: int
    """Counts a publisher's messages or a client's requests from 1; a response carries that of its request."""
    stamp_ns: int
    """Sender's clock, since 1970."""
    gid: bytes
    """Of the publisher, or of the client in requests and responses."""

    def pack(self) -> bytes:
        """The attachment as it travels."""
        return _FORMAT.pack(self.number, self.stamp_ns, GID_BYTES, self.gid)

    @classmethod
    def unpack(cls, payload: bytes) -> Attachment:
        """Read an attachment.

        Raises:
            BadAttachment: it has another length, or a negative number or stamp, which rmw_zenoh refuses too.

        """
        if len(payload) != _FORMAT.size:
            raise BadAttachment(f"expected an attachment of {_FORMAT.size} bytes, got {len(payload)}")
        number, stamp_ns, gid_bytes, gid = _FORMAT.unpack(payload)
        if gid_bytes != GID_BYTES:
            raise BadAttachment(f"expected a gid of {GID_BYTES} bytes, got {gid_bytes}")
        if number < 0 or stamp_ns < 0:
            raise BadAttachment(f"expected a number and a stamp from 0, got {number} and {stamp_ns}")
        return cls(number, stamp_ns, gid)


INBOX_BYTES_MAX = 134_217_728
"""Of all messages that wait in one subscription (chosen: eight of the largest)."""
CAPACITY_MAX = 4096
"""Messages that wait, for any depth."""


class RosSubscription(Generic[M]):
    """A subscription over a Zenoh session, which only appends on Zenoh's threads; `take` decodes.

    Args:
        session: brings the messages.
        entity: the subscription as others see it; its depth is how many messages wait, of which the oldest is dropped.
        kind: type of its messages.

    """

    def __init__(self, session: zenoh.Session, entity: Entity, kind: MessageType[M]) -> None:
        self.entity = entity
        self.dropped = 0
        """Messages that arrived faster than they were taken."""
        self.reasons: Counter[str] = Counter()
        """How many messages were refused, by `too_large`, `no_sender` and `malformed`."""
        self.on_arrival: Callable[[], None] | None = None
        """Called on Zenoh's thread after each message."""
        self._kind = kind
        self._capacity = min(max(entity.qos.depth, 1), CAPACITY_MAX)
        self._waiting: deque[tuple[bytes, bytes]] = deque()
        self._bytes = 0
        self._lock = threading.Lock()
        self._subscriber: Any = _subscribe(session, entity.key, entity.qos, self._receive)
        self._token: Any = session.liveliness().declare_token(entity.token)

    @property
    def refused(self) -> int:
        """See `Reader`."""
        return self.reasons.total()

    def read(self) -> list[ReceivedMessage[M]]:
        """See `Reader`."""
        with self._lock:
            waiting, self._waiting, self._bytes = self._waiting, deque(), 0
        received = []
        for payload, attached in waiting:
            try:
                sender = Attachment.unpack(attached)
                received.append(ReceivedMessage(self._kind.decode(payload), sender.stamp_ns, sender.gid, sender.number))
            except BadAttachment:
                self._refuse("no_sender")
            except BadCdr:
                self._refuse("malformed")
        return received

    def close(self) -> None:
        """See `Reader`."""
        declared, self._subscriber = self._subscriber, None
        if declared is not None:
            with suppress(zenoh.ZError):  # the session is closed, which ended both
                self._token.undeclare()
                declared.undeclare()

    def _receive(self, sample: zenoh.Sample) -> None:
        size = len(sample.payload)
        if size > self._kind.max_bytes:
            self._refuse("too_large")
            return
        attached = sample.attachment.to_bytes() if sample.attachment is not None else b""
        with self._lock:
            self._waiting.append((sample.payload.to_bytes(), attached))
            self._bytes += size
            while len(self._waiting) > self._capacity or self._bytes > INBOX_BYTES_MAX:
                self._bytes -= len(self._waiting.popleft()[0])
                self.dropped += 1
        if self.on_arrival is not None:
            self.on_arrival()

    def _refuse(self, reason: str) -> None:
        with self._lock:
            self.reasons[reason] += 1


def _subscribe(session: zenoh.Session, key: str, qos: Qos, receive: Callable[[zenoh.Sample], None]) -> Any:
    """Declare as rmw_subscription_data.cpp does."""
    callback: Any = zenoh.handlers.Callback(receive, indirect=False)
    if not qos.is_latched:
        return session.declare_subscriber(key, callback)
    is_reliable = qos.reliability is Reliability.RELIABLE
    recovery = zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True) if is_reliable else None
    return zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        callback,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=max(qos.depth, 1)),
        recovery=recovery,
        subscriber_detection=True,
    )


HEARTBEAT_S = 0.5
"""Of rmw_zenoh: period in which a latched, reliable publisher sends the number of its last message after that
message."""


class RosPublisher(Generic[M]):
    """A publisher over a Zenoh session. Thread-safe.

    Args:
        session: carries the messages; has timestamps on if `entity` is latched (`open_session` does that).
        entity: the publisher as others see it.
        kind: type of its messages.
        now_ns: the clock for stamps.

    """

    def __init__(self, session: zenoh.Session, entity: Entity, kind: MessageType[M], now_ns: Callable[[], int]) -> None:
        self.entity = entity
        self.count = 0
        """Messages sent."""
        self._kind = kind
        self._now_ns = now_ns
        self._gid = entity.gid
        self._lock = threading.Lock()
        self._publisher: Any = _declare(session, entity.key, entity.qos)
        self._token: Any = session.liveliness().declare_token(entity.token)

    def publish(self, message: M) -> None:
        """See `Writer`; after `close` it does nothing."""
        self.publish_bytes(self._kind.encode(message))

    def publish_bytes(self, payload: bytes) -> None:
        """Send a message that is encoded already."""
        with self._lock:  # numbers go out in order
            if self._publisher is None:
                return
            self.count += 1
            attachment = Attachment(self.count, self._now_ns(), self._gid)
            self._publisher.put(payload, attachment=attachment.pack())

    def close(self) -> None:
        """See `Writer`."""
        with self._lock:
            if self._publisher is None:
                return
            with suppress(zenoh.ZError):  # the session is closed, which ended both
                self._token.undeclare()
                self._publisher.undeclare()
            self._publisher = None


def _declare(session: zenoh.Session, key: str, qos: Qos) -> Any:
    """Declare as rmw_publisher_data.cpp does."""
    is_reliable = qos.reliability is Reliability.RELIABLE
    blocks = is_reliable and qos.history is History.KEEP_ALL
    options: dict[str, Any] = {
        "congestion_control": zenoh.CongestionControl.BLOCK if blocks else zenoh.CongestionControl.DROP,
        "reliability": zenoh.Reliability.RELIABLE if is_reliable else zenoh.Reliability.BEST_EFFORT,
    }
    if not qos.is_latched:
        return session.declare_publisher(key, **options)
    heartbeat = zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=HEARTBEAT_S)
    return zenoh.ext.declare_advanced_publisher(
        session,
        key,
        **options,
        cache=zenoh.ext.CacheConfig(max(qos.depth, 1)),
        sample_miss_detection=heartbeat if is_reliable else None,
        publisher_detection=True,
    )


WAITING_MAX = 64
"""Requests that wait in one server."""


class RosRequest(Generic[Q, R]):
    """A request that waits for its response; see `Request`. Dropping it without a word ends the query as well."""

    def __init__(self, server: RosServer[Q, R], query: zenoh.Query, sender: Attachment, request: Q) -> None:
        self.request = request
        self.sender = sender
        """Client's gid, the number of its request, and when it was sent."""
        self._server, self._query = server, query

    def reply(self, response: R) -> None:
        """See `Request`.

        Raises:
            BadCdr: it cannot be encoded; the query is still open.

        """
        payload = self._server.kind.response.encode(response)
        attachment = Attachment(self.sender.number, self._server.now_ns(), self.sender.gid)
        with suppress(zenoh.ZError), self._query:  # the client or the session may be gone
            self._query.reply(self._server.entity.key, payload, attachment=attachment.pack())

    def refuse(self, why: str) -> None:
        """See `Request`."""
        _refuse(self._query, why)


class RosServer(Generic[Q, R]):
    """A service over a Zenoh session, which only appends on Zenoh's threads; `requests` decodes.

    Args:
        session: brings the requests.
        entity: the server as others see it.
        kind: type of the service.
        now_ns: the clock for stamps.

    """

    def __init__(
        self, session: zenoh.Session, entity: Entity, kind: ServiceType[Q, R], now_ns: Callable[[], int]
    ) -> None:
        self.entity = entity
        self.dropped = 0
        self.refused = 0
        self.on_arrival: Callable[[], None] | None = None
        """Called on Zenoh's thread after each request."""
        self.kind, self.now_ns = kind, now_ns
        self._waiting: deque[zenoh.Query] = deque()
        self._lock = threading.Lock()
        callback: Any = zenoh.handlers.Callback(self._receive_request, indirect=False)
        self._queryable: Any = session.declare_queryable(entity.key, callback, complete=True)
        self._token: Any = session.liveliness().declare_token(entity.token)

    def requests(self) -> list[RosRequest[Q, R]]:
        """See `Server`."""
        with self._lock:
            waiting, self._waiting = self._waiting, deque()
        found = []
        for query in waiting:
            try:
                sender = Attachment.unpack(query.attachment.to_bytes() if query.attachment is not None else b"")
                request = self.kind.request.decode(query.payload.to_bytes() if query.payload is not None else b"")
            except (BadAttachment, BadCdr) as error:
                self.refused += 1
                _refuse(query, str(error))
                continue
            found.append(RosRequest(self, query, sender, request))
        return found

    def close(self) -> None:
        """See `Server`."""
        declared, self._queryable = self._queryable, None
        if declared is None:
            return
        with suppress(zenoh.ZError):  # the session is closed, which ended both
            self._token.undeclare()
            declared.undeclare()
        with self._lock:
            waiting, self._waiting = self._waiting, deque()
        for query in waiting:
            _refuse(query, "the service ends")

    def _receive_request(self, query: zenoh.Query) -> None:
        size = len(query.payload) if query.payload is not None else 0
        if size > self.kind.request.max_bytes:
            self.refused += 1
            _refuse(query, f"{size} bytes: expected at most {self.kind.request.max_bytes}")
            return
        with self._lock:
            is_full = len(self._waiting) >= WAITING_MAX
            if not is_full:
                self._waiting.append(query)
        if is_full:
            self.dropped += 1
            _refuse(query, f"{WAITING_MAX} requests wait already")
        elif self.on_arrival is not None:
            self.on_arrival()


def _refuse(query: zenoh.Query, why: str) -> None:
    with suppress(zenoh.ZError), query:  # the client or the session may be gone
        query.reply_err(why.encode())


_NUMBERS = itertools.count()
"""Of nodes and their parts: unique in the process, and so in each of its sessions."""


class RosNode:
    """A node of ROS 2; a `RosPort`.

    It is a member of the live drive: its messages come on Zenoh's threads, and wait to be read.

    Args:
        session: not closed by the node.
        name: the node's name.
        namespace: of the node and its relative names.
        domain: `ROS_DOMAIN_ID` of those it speaks to.
        now_ns: the clock for stamps, since 1970.

    Raises:
        BadRosName: a name against the rules of ROS 2.

    """

    def __init__(
        self,
        session: zenoh.Session,
        name: str,
        *,
        namespace: str = "/",
        domain: int = 0,
        now_ns: Callable[[], int],
    ) -> None:
        self.id = NodeId(
            check_domain(domain),
            str(session.zid()),
            next(_NUMBERS),
            check_namespace(namespace),
            check_node_name(name),
        )
        self._session = session
        self._now_ns = now_ns
        self._own: list[RosPublisher[Any] | RosSubscription[Any] | RosServer[Any, Any]] = []
        self._token: Any = session.liveliness().declare_token(Entity(EntityKind.NODE, self.id, self.id.number).token)

    def advertise(self, topic: str, kind: MessageType[M], qos: Qos = RELIABLE) -> RosPublisher[M]:
        """See `RosPort`."""
        entity = self._entity(EntityKind.PUBLISHER, topic, kind, qos)
        publisher = RosPublisher(self._session, entity, kind, self._now_ns)
        self._own.append(publisher)
        return publisher

    def subscribe(self, topic: str, kind: MessageType[M], qos: Qos = RELIABLE) -> RosSubscription[M]:
        """See `RosPort`."""
        subscription = RosSubscription(self._session, self._entity(EntityKind.SUBSCRIPTION, topic, kind, qos), kind)
        self._own.append(subscription)
        return subscription

    def serve(self, service: str, kind: ServiceType[Q, R]) -> RosServer[Q, R]:
        """See `RosPort`."""
        entity = self._entity(EntityKind.SERVER, service, kind, RELIABLE)
        server = RosServer(self._session, entity, kind, self._now_ns)
        self._own.append(server)
        return server

    def close(self) -> None:
        """See `RosPort`."""
        while self._own:
            self._own.pop().close()
        with suppress(zenoh.ZError):  # the session is closed, or the node
            self._token.undeclare()

    def _entity(self, kind: EntityKind, name: str, type_: MessageType[Any] | ServiceType[Any, Any], qos: Qos) -> Entity:
        full = full_name(name, self.id.namespace, self.id.name)
        return Entity(kind, self.id, next(_NUMBERS), full, type_.name, type_.type_hash, qos)
