"""The recorder's inbox: bounded in messages and in bytes, and it knows of which topics it had to refuse some."""

from collections import Counter

from robrain.protocol.wire.border.border import Border, Heard
from robrain.protocol.wire.inbox import Inbox


class RecorderInbox(Inbox):
    """Keeps every message until the recorder's step. What comes when it is full is not taken in.

    Refusing the newest, where other inboxes let the oldest go, leaves a recording that breaks off at a known place
    and is whole before it.

    Args:
        capacity: messages held at the most.
        capacity_bytes: bytes of their payloads held at the most.
        border: as in `Inbox`.
    """

    def __init__(self, capacity: int, capacity_bytes: int, border: Border | None = None) -> None:
        super().__init__(capacity, every=True, border=border)
        self.capacity_bytes = capacity_bytes
        self.dropped_by_topic: Counter[str] = Counter()
        self._bytes = 0

    def append(self, topic: Heard, key: str, payload: bytes, *, outside: bool = False) -> bool:
        """Take a message in, or count it as refused or dropped."""
        self.received += 1
        self.outside += outside
        if len(payload) > topic.payloads.max_bytes and not self.border.admits(topic, key, payload):
            self.refused += 1
            return False
        size = len(payload)
        if len(self._every) >= self.capacity or self._bytes + size > self.capacity_bytes:
            self.dropped += 1
            self.dropped_by_topic[topic.name] += 1
            return False
        self._bytes += size
        self._every.append((topic, key, payload))
        return True

    def drain_raw(self) -> list[tuple[Heard, str, bytes]]:
        """Take everything out as topic, key and payload, in order of arrival."""
        raw = super().drain_raw()
        taken = sum(len(payload) for _, _, payload in raw)  # first: what comes while it is reckoned counts as well
        self._bytes -= taken
        return raw
