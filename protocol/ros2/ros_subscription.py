"""A subscription as `rmw_zenoh` declares it: one that is latched asks publishers for what they sent before."""

import threading
from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Generic, TypeVar

import zenoh
import zenoh.ext

from robrain.protocol.ros2.attachment import Attachment
from robrain.protocol.ros2.errors import BadAttachment, BadCdr
from robrain.protocol.ros2.message_types import MessageType
from robrain.protocol.ros2.qos import Qos, Reliability
from robrain.protocol.ros2.ros_port import ReceivedMessage
from robrain.protocol.ros2.tokens import Entity

INBOX_BYTES_MAX = 134_217_728
"""Of all messages that wait in one subscription (chosen: eight of the largest)."""
CAPACITY_MAX = 4096
"""Messages that wait, whatever depth is asked for."""

M = TypeVar("M")


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
        self.last_refusal = ""
        """Why, of the last one that was."""
        self.on_arrival: Callable[[], None] | None = None
        """Called on Zenoh's thread after each message."""
        self._kind = kind
        self._capacity = min(max(entity.qos.depth, 1), CAPACITY_MAX)
        self._waiting: deque[tuple[bytes, bytes]] = deque()
        self._bytes = 0
        self._lock = threading.Lock()
        self._subscriber: Any = _declare(session, entity.key, entity.qos, self._hear)
        self._token: Any = session.liveliness().declare_token(entity.token)

    @property
    def refused(self) -> int:
        """See `Reader`."""
        return self.reasons.total()

    def take(self) -> list[ReceivedMessage[M]]:
        """See `Reader`."""
        with self._lock:
            waiting, self._waiting, self._bytes = self._waiting, deque(), 0
        heard = []
        for payload, attached in waiting:
            try:
                sender = Attachment.unpack(attached)
                heard.append(ReceivedMessage(self._kind.decode(payload), sender.stamp_ns, sender.gid, sender.number))
            except BadAttachment as error:
                self._refuse("no_sender", str(error))
            except BadCdr as error:
                self._refuse("malformed", str(error))
        return heard

    def close(self) -> None:
        """See `Reader`."""
        declared, self._subscriber = self._subscriber, None
        if declared is not None:
            with suppress(zenoh.ZError):  # the session is closed, which ended both
                self._token.undeclare()
                declared.undeclare()

    def _hear(self, sample: zenoh.Sample) -> None:
        size = len(sample.payload)
        if size > self._kind.max_bytes:
            self._refuse("too_large", f"{size} bytes: expected at most {self._kind.max_bytes}")
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

    def _refuse(self, reason: str, why: str) -> None:
        with self._lock:
            self.reasons[reason] += 1
            self.last_refusal = why


def _declare(session: zenoh.Session, key: str, qos: Qos, hear: Callable[[zenoh.Sample], None]) -> Any:
    """Declare as rmw_subscription_data.cpp does."""
    callback: Any = zenoh.handlers.Callback(hear, indirect=False)
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
