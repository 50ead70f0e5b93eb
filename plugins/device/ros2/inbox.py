"""Messages of a ROS topic between two steps of the plugin that reads them."""

from collections import deque
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

M = TypeVar("M")

INBOX_MESSAGES = 256


class Arrived(NamedTuple, Generic[M]):
    """A message that has come."""

    message: M
    arrived_ns: int
    """Time of its arrival, ns since 1970."""
    number: int
    """Its publisher's count of messages; 0 if the middleware does not say."""


class Ros2Inbox(Generic[M]):
    """Messages of one topic; at most `INBOX_MESSAGES`, the oldest are dropped.

    Args:
        on_arrival: called after each message, on the thread of the node.

    """

    def __init__(self, on_arrival: Callable[[], None]) -> None:
        self.dropped = 0
        self._on_arrival = on_arrival
        self._messages: deque[Arrived[M]] = deque(maxlen=INBOX_MESSAGES)

    def __len__(self) -> int:
        return len(self._messages)

    def put(self, message: M, arrived_ns: int, number: int = 0) -> None:
        """Take a message in; on the thread of the node."""
        self.dropped += len(self._messages) == INBOX_MESSAGES
        self._messages.append(Arrived(message, arrived_ns, number))
        self._on_arrival()

    def drain(self) -> list[Arrived[M]]:
        """Take all messages out, in order of arrival."""
        return [self._messages.popleft() for _ in range(len(self._messages))]
