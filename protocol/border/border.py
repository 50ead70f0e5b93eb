"""The border: the one place where a payload from the wire becomes a value, or is refused and counted."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from robrain.protocol.clock import Clock, clock_difference_ns
from robrain.protocol.codec import BAD_PAYLOAD, Codec
from robrain.protocol.refusals import RefusalCode, Refusals
from robrain.protocol.topic import Query, Topic

Incoming = Topic[Any] | Query[Any, Any]
"""Entries of an inbox: messages of topics, and replies to queries."""
KEYS_MAX = 8192
"""Keys whose parsed names are cached."""


class Received(NamedTuple):
    """One sample out of an inbox."""

    topic: Incoming
    key: str
    names: dict[str, str]
    """Names in the key, and its team under `team`."""
    message: Any
    """Decoded; bytes where there is no type."""


new_received = tuple.__new__
"""Makes a `Received` as its class does, in a third of the time."""


class Border:
    """Decodes and checks payloads.

    A payload is refused if it is larger than its topic allows, or if its names differ from those in the key. It is also
    refused if it does not decode into the topic's type with all numbers and lengths in range. Times in messages of
    `Timed` types are converted to the receiver's clock if the sender's clock differs.

    Args:
        clock: the run's clock; None leaves times as they are.
        refusals: counts refusals.

    """

    def __init__(self, clock: Clock | None = None, refusals: Refusals | None = None) -> None:
        self._clock = clock
        self._refusals = refusals
        self._names: dict[str, dict[str, str]] = {}

    def admits(self, topic: Incoming, key: str, payload: bytes) -> bool:
        """Whether a payload is small enough; one that is not is counted as refused."""
        if len(payload) <= topic.payloads.max_bytes:
            return True
        self._refuse(topic, key, RefusalCode.TOO_LARGE, topic.payloads.too_large(len(payload)))
        return False

    def read(self, topic: Incoming, key: str, payload: bytes) -> Received | None:
        """The message in a payload, or None if it is refused."""
        names = self._names.get(key) or self._record_names(topic, key)
        if names is None:
            self._refuse(topic, key, RefusalCode.WRONG_NAME, "a name in its key is not one")
            return None
        codec: Codec[Any] = topic.payloads
        if len(payload) > codec.max_bytes:
            self._refuse(topic, key, RefusalCode.TOO_LARGE, codec.too_large(len(payload)))
            return None
        try:
            message = codec.decode(payload or codec.empty)
        except BAD_PAYLOAD as error:
            self._refuse(topic, key, RefusalCode.MALFORMED, codec.not_one(error))
            return None
        for field in topic.named_twice:
            if message is not None and getattr(message, field, None) != names[field]:
                self._refuse(topic, key, RefusalCode.WRONG_NAME, other_names(topic, names, message))
                return None
        if topic.is_timed and self._clock is not None:
            ahead_ns = clock_difference_ns(message.stamp_ns, self._clock.now_ns())
            message = message.moved_in_time(-ahead_ns) if ahead_ns else message
        return new_received(Received, (topic, key, names, message))

    def _record_names(self, topic: Incoming, key: str) -> dict[str, str] | None:
        names = topic.parse(key)
        if names is not None:
            if len(self._names) >= KEYS_MAX:
                self._names.clear()
            self._names[key] = names
        return names

    def record_lost(self, topic: Incoming, key: str, count: int) -> None:
        """Count messages that were lost for good in transit."""
        if self._refusals is not None:
            why = "the network was away or full for longer than its sender keeps them"
            self._refusals.record(topic.name, key, RefusalCode.LOST, why, count)

    def _refuse(self, topic: Incoming, key: str, code: RefusalCode, why: str) -> None:
        if self._refusals is not None:
            self._refusals.record(topic.name, key, code, why)


def other_names(topic: Incoming, names: Mapping[str, str], message: object) -> str:
    """How the names in a message differ from those in its key; empty if they do not."""
    for field in topic.named_twice:
        name = getattr(message, field, None)
        if message is not None and name != names.get(field):
            return f"its key says {field} {names.get(field)}, its payload {name}"
    return ""
