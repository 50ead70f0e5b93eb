"""Messages that wait to be carried, by urgency: when there is no room, the oldest of the least urgent go."""

from collections import deque
from typing import Any, NamedTuple

from robrain.protocol.wire.topic import Topic, Urgency


class Message(NamedTuple):
    """What was said on one side."""

    topic: Topic[Any]
    key: str
    payload: bytes
    mark: bytes
    """Says on which sides it has been."""


class Waiting:
    """A bounded queue; its caller sees to it that one thread uses it at a time.

    Args:
        most: of messages.

    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._by_urgency: dict[Urgency, deque[Message]] = {urgency: deque() for urgency in Urgency}

    def put(self, message: Message) -> bool:
        """Let a message wait; whether one was dropped for it, maybe this one."""
        self._by_urgency[message.topic.urgency].append(message)
        if sum(map(len, self._by_urgency.values())) <= self._most:
            return False
        next(queue for queue in reversed(self._by_urgency.values()) if queue).popleft()
        return True

    def take(self) -> list[Message]:
        """All of them, the most urgent first and each kind in the order of its arrival."""
        found = [message for queue in self._by_urgency.values() for message in queue]
        for queue in self._by_urgency.values():
            queue.clear()
        return found
