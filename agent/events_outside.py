"""Events that leave the robot: a publisher for each marked event of an active plugin."""

import logging
import threading
from collections.abc import Mapping
from typing import Any

import msgspec
import zenoh

from robrain.agent.event import Event
from robrain.agent.text_form import encode_own
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.messages import plugin_messages
from robrain.protocol.wire.publisher import Publisher
from robrain.protocol.wire.topics import ROBOT_EVENT

logger = logging.getLogger(__name__)


class EventsOutside:
    """Puts what one plugin notifies on the robot's `event/` topic.

    Args:
        wire: the plugin's place on the wire.
        robot: whose plugin it is.
        plugin: its name.

    """

    def __init__(self, wire: Endpoint, robot: str, plugin: str) -> None:
        self._wire = wire
        self._robot = robot
        self._plugin = plugin
        self._ways_out: list[_WayOut] = []

    def open(self, events: Mapping[str, Event[Any]]) -> None:
        """Let the marked ones of these leave the robot until `close`."""
        for name, event in events.items():
            if event.outside:
                names = {"robot": self._robot, "plugin": self._plugin, "event": name}
                publisher = self._wire.publisher(ROBOT_EVENT, **names)
                self._ways_out.append(_WayOut(event, publisher, self._robot, self._plugin, name))

    def close(self) -> None:
        """Undeclare all; what is notified from now on stays in the robot."""
        ways_out, self._ways_out = self._ways_out, []
        for way_out in ways_out:
            way_out.close(declared=not self._wire.is_closed)


class _WayOut:
    """One event's way off the robot; a notifier's thread may be in `put` while another closes it."""

    def __init__(self, event: Event[Any], publisher: Publisher, robot: str, plugin: str, name: str) -> None:
        self._event = event
        self._publisher = publisher
        self._message = plugin_messages.Event(robot=robot, plugin=plugin, event=name)
        self._lock = threading.Lock()
        self._is_open = True
        event.leave = self.put

    def put(self, value: Any) -> None:
        try:
            encoded = msgspec.Raw(msgspec.json.encode(value, enc_hook=encode_own))
        except Exception as error:  # noqa: BLE001 - the plugin's own JSON encoder is foreign code
            self._event.unsent += 1
            if self._event.unsent == 1:
                robot, where = self._message.robot, f"event {self._message.event} of plugin {self._message.plugin}"
                what = f"{type(error).__name__}: {error}"
                logger.error("%s: %s stays in the robot: %s", robot, where, what)  # noqa: TRY400 - `what` names the error
            return
        with self._lock:
            if not self._is_open:
                return
            try:
                self._publisher.put(msgspec.structs.replace(self._message, value=encoded))
            except zenoh.ZError:  # the session has gone, and the robot with it: no fault of the plugin's
                self._event.unsent += 1
            except ValueError as error:  # it is too large
                self._event.unsent += 1
                if self._event.unsent == 1:
                    message = self._message
                    what = f"{message.robot}: event {message.event} of plugin {message.plugin}"
                    logger.error("%s stays in the robot: %s", what, error)  # noqa: TRY400 - a traceback adds nothing

    def close(self, *, declared: bool) -> None:
        with self._lock:
            self._is_open = False
            if self._event.leave == self.put:  # not that of the instance which took the event over
                self._event.leave = None
            if declared:
                self._publisher.close()
