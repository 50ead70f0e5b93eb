"""Bounded inboxes: where subscriptions put what arrives, until their component's next step."""

from collections import deque
from typing import Any, NamedTuple

import zenoh

from robrain.protocol.wire.codec import BadPayload, Codec
from robrain.protocol.wire.refusals import RefusalCode, Refusals
from robrain.protocol.wire.topic import Delivery, Query, Topic

NOTHING = b"null"
"""An empty reply: JSON null."""
Heard = Topic[Any] | Query[Any, Any]
"""What may lie in an inbox: messages of topics, and replies to queries."""
KEYS_MAX = 8192
"""Keys whose parsed names are cached."""


class Received(NamedTuple):
    """One sample out of an inbox."""

    topic: Heard
    key: str
    names: dict[str, str]
    """Names in the key, and its team under `team`."""
    message: Any
    """Decoded; bytes where there is no type."""


class Inbox:
    """Holds samples between two steps of its owner. Callbacks only ever append.

    On topics delivered as LATEST a new sample replaces the previous one of its key. At `capacity` the oldest sample is
    dropped, or, on LATEST topics, a sample with a new key; `dropped` counts both. A sample that is larger than its
    topic allows, does not decode, or names different senders in key and payload is refused: counted in `malformed`,
    and in `refusals` with its sender and the reason.

    Args:
        capacity: samples held at the most, of those that count singly and of the latest ones each.
        every: keep each sample, also of topics on which only the latest counts.
    """

    def __init__(self, capacity: int = 1024, *, every: bool = False) -> None:
        self.capacity = capacity
        self.every = every
        self.outside = 0
        """Samples that reached a lockstep run from another process."""
        self.dropped = 0
        self.malformed = 0
        self.refusals: Refusals | None = None
        """Set by the endpoint that fills this inbox; None before."""
        self.received = 0
        self._every: deque[tuple[Heard, str, bytes]] = deque(maxlen=capacity)
        self._expected: deque[tuple[Any, Heard, str]] = deque(maxlen=capacity)
        self._latest: dict[str, tuple[Heard, str, bytes]] = {}
        self._names: dict[str, dict[str, str]] = {}

    def append(self, topic: Heard, key: str, payload: bytes, *, outside: bool = False) -> None:
        """Take a sample in; called by subscriptions, on whatever thread they run."""
        self.received += 1
        self.outside += outside
        if len(payload) > topic.payloads.max_bytes:
            self._refuse(topic, key, RefusalCode.TOO_LARGE, topic.payloads.too_large(len(payload)))
            return
        if isinstance(topic, Topic) and topic.delivery is Delivery.LATEST and not self.every:
            if len(self._latest) >= self.capacity and key not in self._latest:
                self.dropped += 1
            else:
                self._latest[key] = (topic, key, payload)
            return
        # The deque itself lets the oldest go: a popleft here could meet the owner's in `drain` on an empty deque.
        self.dropped += len(self._every) == self.capacity
        self._every.append((topic, key, payload))

    def __len__(self) -> int:
        return len(self._every) + len(self._latest)

    def expect(self, replies: Any, topic: Heard, key: str) -> None:
        """Take in what comes as the reply to a query, for the owner's own thread; the last so many are waited for.

        Args:
            replies: the query's channel; it says None as long as there is nothing, and raises ZError at its end.
            topic: what a reply is taken for.
            key: likewise.

        """
        self._expected.append((replies, topic, key))

    def drain(self) -> list[Received]:
        """Take everything out, decoded: first what counts singly, in order of arrival, then the latest ones."""
        if not self._every and not self._latest and not self._expected:
            return []
        return [received for sample in self.drain_raw() if (received := self._decode(*sample)) is not None]

    def drain_raw(self) -> list[tuple[Heard, str, bytes]]:
        """Take everything out as topic, key and payload, in the order of `drain`."""
        if self._expected:
            self._take_replies()
        if not self._every and not self._latest:
            return []
        raw = [self._every.popleft() for _ in range(len(self._every))]
        if self._latest:
            raw += [self._latest.pop(key) for key in sorted(self._latest)]
        return raw

    def _take_replies(self) -> None:
        for _ in range(len(self._expected)):
            replies, topic, key = self._expected.popleft()
            try:
                while (reply := replies.try_recv()) is not None:
                    payload = reply.ok.payload.to_bytes() if reply.ok is not None else NOTHING
                    if payload != NOTHING:
                        self.append(topic, key, payload)
            except zenoh.ZError:  # it is answered, or was not in time
                continue
            self._expected.append((replies, topic, key))

    def _decode(self, topic: Heard, key: str, payload: bytes) -> Received | None:
        names = self._names.get(key)
        if names is None:
            if len(self._names) >= KEYS_MAX:
                self._names.clear()
            names = self._names[key] = topic.parse(key) or {}
        payloads: Codec[Any] = topic.payloads
        try:
            message = payloads.read(payload)
        except BadPayload as error:
            self._refuse(topic, key, RefusalCode.MALFORMED, str(error))
            return None
        for field, name_in in topic.named_twice:
            if name_in(message) != names.get(field):
                why = f"its key says {field} {names.get(field)}, its payload {name_in(message)}"
                self._refuse(topic, key, RefusalCode.WRONG_NAME, why)
                return None
        return Received(topic, key, names, message)

    def _refuse(self, topic: Heard, key: str, code: RefusalCode, why: str) -> None:
        self.malformed += 1
        if self.refusals is not None:
            self.refusals.note(topic.name, key, code, why)
