"""Common part of devices that subscribe to one ROS 2 topic: its messages, their times and the rejected ones."""

from collections.abc import Callable
from typing import Any, NamedTuple

from rclpy.qos import qos_profile_sensor_data

from robrain.agent.errors import PluginError
from robrain.agent.plugin import Device, external
from robrain.plugins.device.mocdevice.frame_clock import LeastDelay
from robrain.plugins.device.ros2.link import Ros2Inbox, Ros2Link, Ros2Parameters, open_link
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


class CheckedMessage(NamedTuple):
    """A message that was checked."""

    value: Any
    measured_ns: int
    """Time of measurement, robot's clock."""
    number: int
    """Its publisher's count of messages; 0 if the middleware has none."""


class TopicDevice(Device):
    """Subscribes to one topic, whose messages are checked as they leave the inbox."""

    parameters: Ros2Parameters
    _link: Ros2Link | None = None
    _inbox: Ros2Inbox[Any] | None = None
    _rejected = 0
    _rejection = ""
    """Of the last message that was rejected."""

    def subscribe(
        self,
        kind: type[Any],
        topic: str,
        check: Callable[[Any], tuple[int, Any]],
        on_arrival: Callable[[], None] | None = None,
    ) -> Ros2Link:
        """Open the node, and subscribe to a topic of the robot.

        Args:
            kind: the message's class.
            topic: name of the topic.
            check: returns stamp (0 if absent) and value of a message (ValueError if the message is implausible).
            on_arrival: called after each message, on the thread of the node; by default, it hurries the device.

        """
        link = self._link = open_link(self.env, self.parameters)
        self._topic, self._check, self._stamps = self.parameters.topic(topic), check, StampClock()
        self._rejected, self._rejection = 0, ""
        self._rejected_since = 0
        """Messages that were rejected since the last that was not."""
        self._inbox = link.subscribe(kind, self._topic, qos_profile_sensor_data, on_arrival or self.env.hurry)
        return link

    def received(self) -> list[CheckedMessage]:
        """Messages since the last call (PluginError if the ROS 2 node has failed: a restart opens another)."""
        if self._link is not None and self._link.failure:
            raise PluginError(self.env.plugin, self._link.failure)
        return self.drain()

    def drain(self) -> list[CheckedMessage]:
        """As `received`, also of a node that has failed."""
        accepted = []
        for arrived in self._inbox.drain() if self._inbox is not None else ():
            try:
                stamp_ns, value = self._check(arrived.message)
            except ValueError as error:
                self._rejected += 1
                self._rejected_since += 1
                self._rejection = str(error)
                continue
            self._rejected_since = 0
            measured_ns = self._stamps.measured_ns(stamp_ns, arrived.arrived_ns)
            accepted.append(CheckedMessage(value, measured_ns, arrived.number))
        return accepted

    def silence_reason(self) -> str:
        """Reason why no message is accepted: all are rejected, by which field and value, or none is sent."""
        link = self._link
        if link is None:
            return ""
        if not link.publishers(self._topic):
            return f"{self._topic} has no publisher in ROS domain {link.domain_id}"
        if self._rejected_since:
            return f"{self._rejected_since} messages of {self._topic} were rejected: {self._rejection}"
        return f"the publisher of {self._topic} is silent"

    def deactivate(self) -> None:
        link, self._link = self._link, None
        if self._inbox is not None:
            self._inbox.close()
        if link is not None:
            link.release()

    @external
    def rejected(self) -> int:
        """Messages that were rejected, as a number is out of range or missing."""
        return self._rejected

    @external
    def rejection(self) -> str:
        """Reason for the last rejection; empty if there was none."""
        return self._rejection
