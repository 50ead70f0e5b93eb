"""Interface of robrain to ROS 2, either by `rmw_zenoh`'s keys or by rclpy.

`RosNode` is the port over a Zenoh session. A port over rclpy converts messages by their CDR bytes, which are the same
on both sides (`MessageType.encode`, and `rclpy.serialization`).
"""

from collections.abc import Sequence
from typing import Generic, Protocol, TypeVar

import msgspec

from robrain.protocol.ros2.message_types import MessageType, ServiceType
from robrain.protocol.ros2.qos import RELIABLE, Qos

M = TypeVar("M")
M_in = TypeVar("M_in", contravariant=True)
M_out = TypeVar("M_out", covariant=True)
Q = TypeVar("Q")
Q_out = TypeVar("Q_out", covariant=True)
R = TypeVar("R")
R_in = TypeVar("R_in", contravariant=True)


class ReceivedMessage(msgspec.Struct, Generic[M], frozen=True):
    """A message of another node."""

    message: M
    stamp_ns: int
    """Publisher's clock, since 1970."""
    gid: bytes
    """Of the publisher."""
    number: int
    """Counts the publisher's messages."""


class Writer(Protocol[M_in]):
    """A publisher."""

    def publish(self, message: M_in) -> None:
        """Send a message.

        Raises:
            BadCdr: it cannot be encoded.

        """

    def close(self) -> None:
        """End it."""


class Reader(Protocol[M]):
    """A subscription, which holds arrivals until they are read."""

    @property
    def dropped(self) -> int:
        """Messages that arrived faster than they were taken."""

    @property
    def refused(self) -> int:
        """Number of messages that are too large, do not decode, or have no sender."""

    def read(self) -> list[ReceivedMessage[M]]:
        """Messages since the last call, in order."""

    def close(self) -> None:
        """End it."""


class PendingRequest(Protocol[Q_out, R_in]):
    """A request that waits for its response; call either `reply` or `refuse`, once."""

    @property
    def request(self) -> Q_out:
        """Content of the request."""

    def reply(self, response: R_in) -> None:
        """Answer."""

    def refuse(self, why: str) -> None:
        """End it without a response.

        ROS 2 has no response with a reason, so this is for requests that cannot be answered at all.
        """


class Server(Protocol[Q_out, R_in]):
    """A service; it queues requests until `requests` returns them."""

    @property
    def dropped(self) -> int:
        """Number of requests refused because the queue was full."""

    @property
    def refused(self) -> int:
        """Number of requests that are too large, do not decode, or have no sender."""

    def requests(self) -> "Sequence[PendingRequest[Q_out, R_in]]":
        """Requests since the last call, in order."""

    def close(self) -> None:
        """End it, and refuse waiting requests."""


class RosPort(Protocol):
    """A node of ROS 2."""

    def advertise(self, topic: str, kind: MessageType[M], qos: Qos = RELIABLE) -> Writer[M]:
        """Publish on a topic.

        Args:
            topic: `/absolute`, `relative` to the node's namespace, or `~/private`.
            kind: type of its messages.
            qos: `LATCHED` for messages that late subscriptions are to get too.

        Raises:
            BadRosName: `topic` is no name of ROS 2.

        """

    def subscribe(self, topic: str, kind: MessageType[M], qos: Qos = RELIABLE) -> Reader[M]:
        """Subscribe to a topic; `qos.depth` messages wait at the most. Arguments and errors as for `advertise`."""

    def serve(self, service: str, kind: ServiceType[Q, R]) -> Server[Q, R]:
        """Answer requests. Arguments and errors as for `advertise`."""

    def close(self) -> None:
        """End the node and all that it has."""
