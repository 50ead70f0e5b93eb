"""Stands for the ROS 2 node of an agent, so that a test speaks and hears on its topics."""

from robrain.plugins.device.ros2.link import Ros2Inbox


class Spoken(Ros2Inbox):
    """A subscription that the test speaks to."""

    is_closed = False

    def close(self):
        self.is_closed = True


class Heard:
    """A publisher that keeps what is published."""

    def __init__(self):
        self.messages = []
        self.is_closed = False

    def publish(self, message):
        assert not self.is_closed
        self.messages.append(message)

    def listeners(self):
        return 1

    def close(self):
        self.is_closed = True


class Link:
    """Stands for the node of the process."""

    domain_id = 7

    def __init__(self):
        self.failure = ""
        self.users = 0
        self.inboxes = {}
        self.heard = {}
        self.ticks = []
        self.present = {"/r1/odom", "/r1/scan", "/r1/imu/data"}

    def subscribe(self, kind, topic, qos, on_arrival):
        self.inboxes[topic] = Spoken(on_arrival)
        return self.inboxes[topic]

    def publisher(self, kind, topic, qos):
        self.heard[topic] = Heard()
        return self.heard[topic]

    def every(self, period_s, function):
        self.ticks.append(function)
        return lambda: self.ticks.remove(function)

    def publishers(self, topic):
        return int(topic in self.present)

    def is_gone(self, topic):
        return not self.publishers(topic)

    def release(self):
        self.users -= 1

    def opened(self, _env, _parameters):
        """Stands for `open_link`."""
        self.users += 1
        return self
