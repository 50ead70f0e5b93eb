"""Notification: events go up.

A plugin declares `finished = Event[str]()` in its class and calls `self.finished.notify("done")`. Observers are
told through their own mailbox: never on the notifier's thread, never under its lock.

Notifications of an `Event[str](outside=True)` also leave the robot, as messages on its `event/` topic. These are put by
the notifier's own thread; putting waits for nobody.
"""

from collections import deque
from collections.abc import Callable
from typing import Any, Generic, Self, TypeVar, overload

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
        """Whether the observer's next step is to be run at once; whoever runs it sets it back."""

    def post(self, function: Callable[[Any], None], value: Any) -> bool:
        """Leave a notification; False if an older one was dropped for it."""
        # The deque itself lets the oldest go: a popleft here could meet that of `deliver` on an empty deque.
        is_full = len(self.waiting) == self.capacity
        self.dropped += is_full
        self.waiting.append((function, value))
        if self.wake is not None:
            self.wake()
        return not is_full

    def hurry(self) -> None:
        """Have the observer's next step run at once."""
        self.is_hurried = True
        if self.wake is not None:
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
        """Tell `function` from now on, through `mailbox`; plugins use `env.observe` instead."""
        self._observers.append((function, mailbox))

    def remove(self, mailbox: Mailbox) -> None:
        """Tell nobody of that mailbox any more."""
        self._observers = [(function, box) for function, box in self._observers if box is not mailbox]

    def notify(self, value: T) -> None:
        """Leave `value` with every observer, and let it leave the robot if the event is marked so."""
        for function, mailbox in self._observers:
            self.dropped += not mailbox.post(function, value)
        leave = self.leave
        if leave is not None:
            leave(value)


class EventView(Generic[T]):
    """What a handle gives out in place of another plugin's event: it can be observed, and nothing else."""

    __slots__ = ("__event",)

    def __init__(self, event: Event[T]) -> None:
        self.__event = event

    def add(self, function: Callable[[T], None], mailbox: Mailbox) -> None:
        """As that of the event."""
        self.__event.add(function, mailbox)

    def remove(self, mailbox: Mailbox) -> None:
        """As that of the event."""
        self.__event.remove(mailbox)
