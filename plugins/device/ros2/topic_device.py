"""What devices share that hear one topic of ROS 2: they leave it when they are stopped, and count what they reject."""

from typing import Any

from robrain.agent.errors import PluginError
from robrain.agent.plugin import Device, external
from robrain.plugins.device.ros2.checked_topic import CheckedTopic
from robrain.plugins.device.ros2.link import Ros2Link


class TopicDevice(Device):
    """Hears one topic; `activate` of a device opens both."""

    _link: Ros2Link | None = None
    _topic: CheckedTopic[Any] | None = None

    def check_node(self) -> None:
        """Raise PluginError if the ROS 2 node has failed: a restart opens another."""
        if self._link is not None and self._link.failure:
            raise PluginError(self.env.plugin, self._link.failure)

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
    def why_rejected(self) -> str:
        """Why the last of them was; empty if none was."""
        return self._topic.why_rejected if self._topic is not None else ""
