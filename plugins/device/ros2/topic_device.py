"""Common part of devices that subscribe to one ROS 2 topic: its messages, their times and the rejected ones."""

from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar

from rclpy.qos import qos_profile_sensor_data

from robrain.agent.errors import PluginError
from robrain.agent.plugin import Device, external
from robrain.plugins.device.mocdevice.frame_clock import LeastDelay
from robrain.plugins.device.ros2.link import Ros2Link, Ros2Parameters, open_link
from robrain.protocol.clock import NS_PER_S, to_ns

LATENCY_MAX_NS = to_ns(0.5)
"""Messages that all come later after their stamps are stamped by another clock."""
AHEAD_MAX_NS = to_ns(0.005)
"""Likewise those with stamps this far in the future; synchronised clocks differ by less."""
RESTART_NS = 3 * NS_PER_S
"""Increase of the delay that is no delay: the other clock has been set, or its process started again."""


class BadMessage(ValueError):
    """A message that is not believed; the text is the reason."""


def stamp_ns_of(message: Any) -> int:
    """The stamp of a message with a header, by its publisher's clock; 0 if it has none."""
    return int(message.header.stamp.sec) * NS_PER_S + int(message.header.stamp.nanosec)


class StampClock:
    """Converts the stamps of one publisher."""

    def __init__(self) -> None:
        self._delay: LeastDelay | None = None

    def measured_ns(self, stamp_ns: int, arrived_ns: int) -> int:
        """The time of measurement, robot's clock, never after arrival.

        Args:
            stamp_ns: the message's; 0 if it has none.
            arrived_ns: when it came, robot's clock.

        """
        if stamp_ns <= 0:
            return arrived_ns
        delay_ns = arrived_ns - stamp_ns
        if self._delay is None or delay_ns - self._delay.ns > RESTART_NS:
            self._delay = LeastDelay()
            self._delay.restart(delay_ns)
        offset_ns = self._delay.observe(delay_ns)
        if -AHEAD_MAX_NS <= offset_ns <= LATENCY_MAX_NS:
            return min(stamp_ns, arrived_ns)
        return min(stamp_ns + offset_ns, arrived_ns)


T = TypeVar("T")


class CheckedMessage(NamedTuple, Generic[T]):
    """A message that was checked."""

    value: T
    measured_ns: int
    """Time of measurement, robot's clock."""
    number: int
    """Its publisher's count of messages; 0 if the middleware has none."""


class CheckedTopic(Generic[T]):
    """A subscription whose messages are checked as they leave the inbox.

    Args:
        link: the node; `close` does not release it.
        kind: the message's class.
        topic: full name of the topic.
        read: returns stamp (0 if absent) and value of a message (ValueError if the message is implausible).
        on_arrival: called after each message, on the thread of the node.

    """

    def __init__(
        self,
        link: Ros2Link,
        kind: type[Any],
        topic: str,
        read: Callable[[Any], tuple[int, T]],
        on_arrival: Callable[[], None],
    ) -> None:
        self.rejected = 0
        self.rejection = ""
        """Of the last message that was rejected."""
        self._rejected_since = 0
        """Messages that were rejected since the last that was not."""
        self._link, self._name, self._read, self._clock = link, topic, read, StampClock()
        self._inbox = link.subscribe(kind, topic, qos_profile_sensor_data, on_arrival)

    @property
    def dropped(self) -> int:
        """Messages that came while too many waited."""
        return self._inbox.dropped

    @property
    def silence_reason(self) -> str:
        """Reason why no message is accepted: all are rejected, by which field and value, or none is sent."""
        if not self._link.publishers(self._name):
            return f"{self._name} has no publisher in ROS domain {self._link.domain_id}"
        if self._rejected_since:
            return f"{self._rejected_since} messages of {self._name} were rejected: {self.rejection}"
        return f"the publisher of {self._name} is silent"

    def __bool__(self) -> bool:
        """Whether a message has arrived."""
        return bool(self._inbox)

    def receive(self) -> list[CheckedMessage[T]]:
        """Messages received since the last call, in order."""
        accepted = []
        for arrived in self._inbox.drain():
            try:
                stamp_ns, value = self._read(arrived.message)
            except ValueError as error:
                self.rejected += 1
                self._rejected_since += 1
                self.rejection = str(error)
                continue
            self._rejected_since = 0
            measured_ns = self._clock.measured_ns(stamp_ns, arrived.arrived_ns)
            accepted.append(CheckedMessage(value, measured_ns, arrived.number))
        return accepted

    def close(self) -> None:
        """Unsubscribe."""
        self._inbox.close()


class TopicDevice(Device):
    """Subscribes to one topic."""

    parameters: Ros2Parameters
    _link: Ros2Link | None = None
    _topic: CheckedTopic[Any] | None = None

    def subscribe(
        self,
        kind: type[Any],
        topic: str,
        read: Callable[[Any], tuple[int, Any]],
        on_arrival: Callable[[], None] | None = None,
    ) -> Ros2Link:
        """Open the node, and subscribe to a topic of the robot; arguments as of `CheckedTopic`.

        A message hurries the device unless there is an `on_arrival`.
        """
        link = self._link = open_link(self.env, self.parameters)
        name = self.parameters.topic(topic)
        self._topic = CheckedTopic(link, kind, name, read, on_arrival or self.env.hurry)
        return link

    def received(self) -> list[CheckedMessage[Any]]:
        """Messages since the last call (PluginError if the ROS 2 node has failed: a restart opens another)."""
        if self._link is not None and self._link.failure:
            raise PluginError(self.env.plugin, self._link.failure)
        return self._topic.receive() if self._topic is not None else []

    def silence_reason(self) -> str:
        """Reason why no message is accepted."""
        return self._topic.silence_reason if self._topic is not None else ""

    def deactivate(self) -> None:
        link, self._link = self._link, None
        if self._topic is not None:
            self._topic.close()
        if link is not None:
            link.release()

    @external
    def rejected(self) -> int:
        """Messages that were rejected, as a number is out of range or missing."""
        return self._topic.rejected if self._topic is not None else 0

    @external
    def rejection(self) -> str:
        """Reason for the last rejection; empty if there was none."""
        return self._topic.rejection if self._topic is not None else ""
