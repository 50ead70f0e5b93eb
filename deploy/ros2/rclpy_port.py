"""The port to ROS 2 by rclpy: messages and services by their CDR bytes, which are the same on both sides.

A type whose package is not installed, such as tf2_msgs from the package index, is skipped, and the log reports it.
"""

import importlib
import logging
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future
from typing import Any, Generic, TypeVar

import rclpy.serialization
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from robrain.plugins.device.ros2.link import Ros2Inbox, Ros2Link, Ros2Publisher
from robrain.protocol.ros2.errors import BadCdr
from robrain.protocol.ros2.message_types import MessageType, ServiceType
from robrain.protocol.ros2.qos import RELIABLE, Qos, Reliability
from robrain.protocol.ros2.ros_port import PendingRequest, ReceivedMessage, Writer

logger = logging.getLogger(__name__)

M = TypeVar("M")
Q = TypeVar("Q")
R = TypeVar("R")

WAITING_MAX = 32
"""Requests of one service that wait to be taken."""
ANSWER_S = 10.0
"""A request is ended without an answer after this; orders end sooner by themselves."""


class RclpyPort:
    """See RosPort.

    Each service has its own node, whose thread waits for the answer: a halt must not wait for a task.

    Args:
        domain_id: ROS domain.
        namespace: of relative topics and services.

    """

    def __init__(self, domain_id: int, namespace: str) -> None:
        self._domain_id, self._namespace = domain_id, namespace
        self._link = Ros2Link("robrain_gateway", domain_id)
        self._servers: list[RclpyServer[Any, Any]] = []

    @property
    def failure(self) -> str:
        """Reason why the node does not run any more; empty while it does."""
        return self._link.failure

    def advertise(self, topic: str, kind: MessageType[M], qos: Qos = RELIABLE) -> Writer[M]:
        """As RosPort."""
        known = _class_of(kind.name)
        publisher = None if known is None else self._link.publisher(known, self._full(topic), _profile(qos))
        return RclpyWriter(kind, publisher)

    def subscribe(self, topic: str, kind: MessageType[M], qos: Qos = RELIABLE) -> "RclpyReader[M]":
        """As RosPort."""
        known = _class_of(kind.name)
        if known is None:
            return RclpyReader(kind, None)
        return RclpyReader(kind, self._link.subscribe(known, self._full(topic), _profile(qos), lambda: None, raw=True))

    def serve(self, service: str, kind: ServiceType[Q, R]) -> "RclpyServer[Q, R]":
        """As RosPort."""
        server: RclpyServer[Q, R] = RclpyServer(self._full(service), kind, self._domain_id)
        self._servers.append(server)
        return server

    def close(self) -> None:
        """As RosPort."""
        for server in self._servers:
            server.close()
        self._link.close()

    def _full(self, name: str) -> str:
        return name if name.startswith("/") else f"{self._namespace}/{name}"


class RclpyWriter(Generic[M]):
    """See Writer; without a publisher messages are discarded."""

    def __init__(self, kind: MessageType[M], publisher: Ros2Publisher | None) -> None:
        self._kind, self._publisher = kind, publisher

    def publish(self, message: M) -> None:
        """As Writer."""
        if self._publisher is not None:
            self._publisher.publish(self._kind.encode(message))

    def close(self) -> None:
        """As Writer."""
        if self._publisher is not None:
            self._publisher.close()


class RclpyReader(Generic[M]):
    """See Reader; without a subscription no messages come."""

    def __init__(self, kind: MessageType[M], subscription: Ros2Inbox[bytes] | None) -> None:
        self.refused = 0
        self._kind, self._subscription = kind, subscription

    @property
    def dropped(self) -> int:
        """As Reader."""
        return self._subscription.dropped if self._subscription is not None else 0

    def read(self) -> list[ReceivedMessage[M]]:
        """As Reader."""
        received = []
        for arrived in self._subscription.drain() if self._subscription is not None else ():
            try:
                message = self._kind.decode(arrived.message)
            except BadCdr:
                self.refused += 1
                continue
            received.append(ReceivedMessage(message, arrived.arrived_ns, b"", arrived.number))
        return received

    def close(self) -> None:
        """As Reader."""
        if self._subscription is not None:
            self._subscription.close()


class RclpyRequest(Generic[Q, R]):
    """See Request."""

    def __init__(self, kind: ServiceType[Q, R], request: Q) -> None:
        self.request = request
        self.done: Future[bytes | None] = Future()
        """The response as CDR; None for none."""
        self._kind = kind

    def reply(self, response: R) -> None:
        """As Request."""
        if not self.done.done():
            self.done.set_result(self._kind.response.encode(response))

    def refuse(self, why: str) -> None:
        """As Request."""
        if not self.done.done():
            self.done.set_result(None)


class RclpyServer(Generic[Q, R]):
    """See Server.

    Args:
        service: its full name.
        kind: its type; if it is not installed, the service is not offered.
        domain_id: ROS domain.

    """

    def __init__(self, service: str, kind: ServiceType[Q, R], domain_id: int) -> None:
        self.dropped = self.refused = 0
        self._kind = kind
        self._waiting: deque[RclpyRequest[Q, R]] = deque()
        self._link: Ros2Link | None = None
        if (known := _class_of(kind.name)) is not None:
            self._response_class = known.Response
            self._link = link = Ros2Link(f"robrain_{service.rpartition('/')[2]}", domain_id)
            link.do(lambda: link.node.create_service(known, service, self._serve))

    def requests(self) -> Sequence[PendingRequest[Q, R]]:
        """As Server."""
        return [self._waiting.popleft() for _ in range(len(self._waiting))]

    def close(self) -> None:
        """As Server."""
        for asked in self.requests():
            asked.refuse("the service ends")
        if self._link is not None:
            self._link.close()

    def _serve(self, request: Any, response: Any) -> Any:
        """On the thread of the service's node, which waits for the answer."""
        try:
            asked = RclpyRequest(self._kind, self._kind.request.decode(rclpy.serialization.serialize_message(request)))
        except BadCdr:
            self.refused += 1
            return response
        if len(self._waiting) >= WAITING_MAX:
            self.dropped += 1
            return response
        self._waiting.append(asked)
        try:
            answer = asked.done.result(ANSWER_S)
        except TimeoutError:
            return response
        return response if answer is None else rclpy.serialization.deserialize_message(answer, self._response_class)


def _class_of(name: str) -> Any:
    """The class of a type such as `nav_msgs/msg/Path`; None if its package is not installed."""
    package, group, kind = name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{group}"), kind)
    except ModuleNotFoundError:
        logger.info("%s is not installed: what is of the type %s is left out", package, name)
        return None


def _profile(qos: Qos) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE
        if qos.reliability is Reliability.RELIABLE
        else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.is_latched else DurabilityPolicy.VOLATILE,
    )
