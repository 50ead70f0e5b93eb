"""Notification: events go up.

A plugin declares `finished = Event[str]()` in its class and calls `self.finished.notify("done")`. Observers are
notified through their own mailbox: never on the notifier's thread, never under its lock.

Notifications of an `Event[str](outside=True)` also leave the robot, as messages on its `event/` topic. These are put by
the notifier's own thread; a put never blocks.
"""

import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Generic, Self, TypeVar, overload

import msgspec
import zenoh

from robrain.agent.text_form import encode_own
from robrain.protocol.messages.robots import plugin_messages
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.wire.endpoint import Endpoint

logger = logging.getLogger(__name__)

T = TypeVar("T")

MAILBOX_CAPACITY = 256


class Mailbox:
    """Notifications that wait for one observer; bounded, and counts what it drops."""

    def __init__(self, capacity: int = MAILBOX_CAPACITY) -> None:
        self.capacity = capacity
        self.dropped = 0
        self.wake: Callable[[], None] | None = None
        """Called after each arrival, so that the observer's thread need not poll."""
        self.waiting: deque[tuple[Callable[[Any], None], Any]] = deque(maxlen=capacity)
        self.is_hurried = False
        """Whether the observer's next step should run at once; the runner resets it."""
        self.bell: bytearray | None = None
        """Set at `bell_index` after each arrival, for a runner that polls it in its own time."""
        self.bell_index = 0

    def post(self, function: Callable[[Any], None], value: Any) -> bool:
        """Leave a notification; False if an older one was dropped for it."""
        # The deque itself lets the oldest go: a popleft here could meet that of `deliver` on an empty deque.
        is_full = len(self.waiting) == self.capacity
        self.dropped += is_full
        self.waiting.append((function, value))
        if self.bell is not None:
            self.bell[self.bell_index] = 1
        elif self.wake is not None:
            self.wake()
        return not is_full

    def ring(self) -> None:
        """Have the runner look at the plugin: something of it has changed."""
        if self.bell is not None:
            self.bell[self.bell_index] = 1
        elif self.wake is not None:
            self.wake()

    def deliver(self) -> None:
        """Call the observing functions, in order of arrival."""
        for _ in range(len(self.waiting)):
            function, value = self.waiting.popleft()
            function(value)

    def __bool__(self) -> bool:
        return bool(self.waiting)


class Event(Generic[T]):
    """An event that a plugin's class declares; each instance of the class has its own.

    Args:
        outside: whether notifications leave the robot too.

    """

    def __init__(self, *, outside: bool = False) -> None:
        self.outside = outside
        self.leave: Callable[[T], None] | None = None
        """Takes a notification off the robot; there while the plugin of a marked event is active."""
        self.unsent = 0
        """Notifications that could not leave the robot: JSON has no word for their value."""
        self._name = ""
        self.dropped = 0
        """Notifications that observers lost because they were too slow."""
        self._observers: list[tuple[Callable[[T], None], Mailbox]] = []

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, instance: None, owner: type) -> Self: ...
    @overload
    def __get__(self, instance: object, owner: type) -> "Event[T]": ...
    def __get__(self, instance: object | None, owner: type) -> "Event[T]":
        if instance is None:
            return self
        own = instance.__dict__.setdefault(self._name, Event[T](outside=self.outside))
        assert isinstance(own, Event)
        return own

    def add(self, function: Callable[[T], None], mailbox: Mailbox) -> None:
        """Notify `function` from now on, through `mailbox`; plugins use `env.observe` instead."""
        self._observers.append((function, mailbox))

    def remove(self, mailbox: Mailbox) -> None:
        """Notify no observer of that mailbox any more."""
        self._observers = [(function, box) for function, box in self._observers if box is not mailbox]

    def notify(self, value: T) -> None:
        """Leave `value` with every observer, and let it leave the robot if the event is marked so."""
        for function, mailbox in self._observers:
            self.dropped += not mailbox.post(function, value)
        leave = self.leave
        if leave is not None:
            leave(value)


class ObservableEvent(Generic[T]):
    """Another plugin's event as a handle returns it: it can only be observed."""

    __slots__ = ("__event",)

    def __init__(self, event: Event[T]) -> None:
        self.__event = event

    def add(self, function: Callable[[T], None], mailbox: Mailbox) -> None:
        """As that of the event."""
        self.__event.add(function, mailbox)

    def remove(self, mailbox: Mailbox) -> None:
        """As that of the event."""
        self.__event.remove(mailbox)


class EventPublisher:
    """Publishes the notifications of one plugin's event on the robot's `event/` topic, until it is closed.

    A notifier's thread may be in `put` while another closes it.

    Args:
        source: event of the plugin.
        wire: the plugin's place on the wire.
        robot, plugin, event: their names.

    """

    def __init__(self, source: Event[Any], wire: Endpoint, *, robot: str, plugin: str, event: str) -> None:
        self._event = source
        self._wire = wire
        self._message = plugin_messages.PluginEvent(robot=robot, plugin=plugin, event=event)
        self._publisher = wire.publisher(ROBOT_EVENT, robot=robot, plugin=plugin, event=event)
        self._lock = threading.Lock()
        self._is_open = True
        source.leave = self.put

    def put(self, value: Any) -> None:
        """Publish a notification; one that cannot leave the robot is counted, and the first one is logged."""
        try:
            encoded = msgspec.Raw(msgspec.json.encode(value, enc_hook=encode_own))
        except Exception as error:  # noqa: BLE001 - the plugin's own JSON encoder is foreign code
            self._record_unsent(f"{type(error).__name__}: {error}")
            return
        with self._lock:
            if not self._is_open:
                return
            try:
                self._publisher.put(msgspec.structs.replace(self._message, value=encoded))
            except zenoh.ZError:  # the session has gone, and the robot with it: no fault of the plugin's
                self._event.unsent += 1
            except ValueError as error:  # it is too large
                self._record_unsent(str(error))

    def close(self) -> None:
        """Undeclare it; later notifications stay in the robot."""
        with self._lock:
            self._is_open = False
            if self._event.leave == self.put:  # not that of the instance which took the event over
                self._event.leave = None
            if not self._wire.is_closed:
                self._publisher.close()

    def _record_unsent(self, reason: str) -> None:
        self._event.unsent += 1
        if self._event.unsent == 1:
            message = self._message
            where = f"event {message.event} of plugin {message.plugin}"
            logger.error("%s: %s stays in the robot: %s", message.robot, where, reason)
