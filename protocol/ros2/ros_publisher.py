"""A publisher as `rmw_zenoh` declares it: with a cache for late subscriptions if it is latched."""

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Generic, TypeVar

import zenoh
import zenoh.ext

from robrain.protocol.ros2.attachment import Attachment
from robrain.protocol.ros2.message_types import MessageType
from robrain.protocol.ros2.qos import History, Qos, Reliability
from robrain.protocol.ros2.tokens import Entity

HEARTBEAT_S = 0.5
"""Of rmw_zenoh: a latched, reliable publisher says this often after a message which number its last one has."""

M = TypeVar("M")


class RosPublisher(Generic[M]):
    """A publisher over a Zenoh session. Thread-safe.

    Args:
        session: carries the messages; has timestamps on if `entity` is latched (`open_session` sees to that).
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
