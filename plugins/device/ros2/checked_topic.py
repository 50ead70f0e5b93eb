"""What a device hears on a topic: messages that were checked, with their time of measurement; others are counted."""

from collections.abc import Callable
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from robrain.plugins.device.ros2.link import Ros2Link
from robrain.plugins.device.ros2.stamp_clock import StampClock


class Stamped(Protocol):
    """What a message reads as."""

    @property
    def stamp_ns(self) -> int:
        """By the publisher's clock."""


T = TypeVar("T", bound=Stamped)


class Measured(NamedTuple, Generic[T]):
    """A message that was checked."""

    value: T
    measured_ns: int
    """Time of measurement, robot's clock."""
    number: int
    """Its publisher's count of messages; 0 if the middleware does not say."""


class CheckedTopic(Generic[T]):
    """A subscription whose messages are checked as they leave the inbox.

    Args:
        link: the node; not released with the topic.
        kind: the message's class.
        topic: its full name.
        qos: `rclpy.qos.QoSProfile`.
        read: checks a message (ValueError if it cannot be).
        on_arrival: called after each message, on the thread of the node.

    """

    def __init__(
        self,
        link: Ros2Link,
        kind: type[Any],
        topic: str,
        qos: Any,
        read: Callable[[Any], T],
        on_arrival: Callable[[], None],
    ) -> None:
        self.rejected = 0
        self.why_rejected = ""
        """Of the last message that was rejected."""
        self._rejected_since = 0
        """Messages that were rejected since the last that was not."""
        self._name, self._read, self._clock = topic, read, StampClock()
        self._inbox = link.subscribe(kind, topic, qos, on_arrival)

    @property
    def dropped(self) -> int:
        """Messages that came while too many waited."""
        return self._inbox.dropped

    @property
    def silence_reason(self) -> str:
        """Why nothing comes of the topic: all messages are rejected, by which field and value, or none is sent."""
        if self._rejected_since:
            return f"{self._rejected_since} messages of {self._name} were rejected: {self.why_rejected}"
        return f"the publisher of {self._name} is silent"

    def __bool__(self) -> bool:
        """Whether something has come."""
        return bool(self._inbox)

    def take(self) -> list[Measured[T]]:
        """What has come since the last call, in order."""
        taken = []
        for arrived in self._inbox.drain():
            try:
                value = self._read(arrived.message)
            except ValueError as error:
                self.rejected += 1
                self._rejected_since += 1
                self.why_rejected = str(error)
                continue
            self._rejected_since = 0
            measured_ns = self._clock.measured_ns(value.stamp_ns, arrived.arrived_ns)
            taken.append(Measured(value, measured_ns, arrived.number))
        return taken

    def close(self) -> None:
        """Hear no more."""
        self._inbox.close()
