"""Bounded inboxes: subscriptions put samples there until their component's next step."""

from collections import deque
from collections.abc import Callable, Sequence
from threading import Lock
from typing import Any

import zenoh

from robrain.protocol.border.border import Border, Incoming, Received

LARGE_BYTES = 4096
INBOX_BYTES_MAX = 134_217_728
"""Of large samples in one inbox (chosen: twice the largest message that a topic allows)."""
NOTHING = b"null"
"""An empty reply: JSON null."""
ASKED_MAX = 5
"""Number of times that a query is sent without an answer."""

Sample = tuple[Incoming, str, bytes, list[Received] | None]
"""Topic, key, payload, and a list for the decoded message, which the first reader fills; None without other inboxes."""


class Inbox:
    """Holds samples between two steps of its owner. Callbacks only ever append.

    On topics delivered as LATEST a new sample replaces the previous one of its key. At `capacity` the oldest sample is
    dropped, or, on LATEST topics, a sample with a new key; `dropped` counts both. `drain` never returns an item that
    the border refuses.

    Samples of more than `LARGE_BYTES` hold at most `max_bytes` together; further ones are dropped. Smaller ones are
    bounded by their number.

    Args:
        capacity: samples held at the most, of those that count singly and of the latest ones each.
        every: keep each sample, also of topics on which only the latest counts.
        border: decodes and checks samples; None uses that of the endpoint that fills the inbox, which counts the
            refusals of all its inboxes together.
        max_bytes: of large samples.
    """

    acts_at_once = False
    """Whether `append` does more than append, so that it may wait: its subscription gets a separate thread."""

    def __init__(
        self,
        capacity: int = 1024,
        *,
        every: bool = False,
        border: Border | None = None,
        max_bytes: int = INBOX_BYTES_MAX,
    ) -> None:
        self.capacity = capacity
        self.max_bytes = max_bytes
        self.large_bytes = 0
        """Of the large samples that came since the last drain, without those that were replaced."""
        self._weighing = Lock()
        self.every = every
        self.outside = 0
        """Samples that reached a lockstep run from another process."""
        self.dropped = 0
        self.refused = 0
        """Samples that the border refused."""
        self.border = Border() if border is None else border
        self._has_own_border = border is not None
        self.received = 0
        self.has_some = False
        """Whether `drain` may have something to take out."""
        self.on_arrival: Callable[[], None] | None = None
        """Called after each sample that was taken, on the thread that brings it."""
        self._every: deque[Sample] = deque(maxlen=capacity)
        self._expected: deque[tuple[Any, Callable[[], Any], int, Incoming, str]] = deque(maxlen=capacity)
        self._latest: dict[str, Sample] = {}

    def adopt(self, border: Border) -> None:
        """Use an endpoint's border, unless the inbox has its own."""
        if not self._has_own_border:
            self.border = border

    def append(self, topic: Incoming, key: str, payload: bytes, *, outside: bool = False) -> bool:
        """Add a sample; called by subscriptions, on any thread.

        Returns:
            Whether it was: False if it is too large, or there is no room for it.

        """
        self.outside += outside
        return self.add((topic, key, payload, None))

    def add(self, sample: Sample) -> bool:
        """Add a sample that other inboxes may hold as well; as `append`."""
        return Inbox.put_into((self,), sample) == 1

    @staticmethod
    def put_into(inboxes: Sequence["Inbox"], sample: Sample) -> int:
        """Add one sample to all inboxes that do not override `add`; returns their number."""
        topic, key, payload, _ = sample
        size, is_latest, count = len(payload), topic.is_latest, 0
        is_large = size > topic.payloads.max_bytes
        for inbox in inboxes:
            inbox.received += 1
            if is_large and not inbox.border.admits(topic, key, payload):
                inbox.refused += 1
                continue
            if size > LARGE_BYTES and not inbox._has_room(key, size, replaces=is_latest and not inbox.every):
                inbox.dropped += 1
                continue
            if is_latest and not inbox.every:
                latest = inbox._latest
                if len(latest) >= inbox.capacity and key not in latest:
                    inbox.dropped += 1
                    continue
                latest[key] = sample
            else:
                # The deque lets the oldest go itself: a popleft here could meet the owner's in `drain` on an empty one.
                every = inbox._every
                inbox.dropped += len(every) == inbox.capacity
                every.append(sample)
            count += 1
            inbox.has_some = True
            if inbox.on_arrival is not None:
                inbox.on_arrival()
        return count

    def _has_room(self, key: str, size: int, *, replaces: bool) -> bool:
        """Whether there is room for a large sample, which is weighed if so; only large ones take the lock."""
        with self._weighing:
            before = self._latest.get(key) if replaces else None
            replaced = len(before[2]) if before is not None and len(before[2]) > LARGE_BYTES else 0
            weight = max(self.large_bytes - replaced, 0) + size
            if weight > self.max_bytes:
                return False
            self.large_bytes = weight
            return True

    def __len__(self) -> int:
        return len(self._every) + len(self._latest)

    def expect(self, ask: Callable[[], Any], topic: Incoming, key: str, asked: int = 1) -> None:
        """Send a query and handle its reply, on the owner's thread; only the latest queries are waited for.

        A query that ends without an answer (silence, or an error) is sent up to `ASKED_MAX` times. When a process or
        the router has just started, or a robot is busy, one query is easily lost.

        Args:
            ask: sends the query and returns its channel, which returns None while there is no reply, and raises ZError
                at its end.
            topic: topic that a reply is read as.
            key: likewise.
            asked: how often it will have been sent.

        """
        self._expected.append((ask(), ask, asked, topic, key))
        self.has_some = True

    def drain(self) -> list[Received]:
        """Return all entries, decoded: first those that count singly, in order of arrival, then the latest ones."""
        if not self.has_some:
            return []
        border = self.border
        read: list[Received] = []
        for topic, key, payload, shared in self.drain_samples():
            received = shared[0] if shared else border.read(topic, key, payload)
            if received is None:
                self.refused += 1
                continue
            if shared is not None and not shared and not topic.is_timed:  # other readers may have other clocks
                shared.append(received)
            read.append(received)
        return read

    def drain_raw(self) -> list[tuple[Incoming, str, bytes]]:
        """Take everything out as topic, key and payload, in the order of `drain`."""
        return [sample[:3] for sample in self.drain_samples()]

    def drain_samples(self) -> list[Sample]:
        """Take everything out as it is shared with other inboxes, in the order of `drain`."""
        self.has_some = False  # first: an arrival in the meantime sets it again
        self.large_bytes = 0
        if self._expected:
            self._collect_replies()
        samples: list[Sample] = []
        every, latest = self._every, self._latest
        for _ in range(len(every)):
            samples.append(every.popleft())
        if latest:
            for key in sorted(latest):
                samples.append(latest.pop(key))
        return samples

    def _collect_replies(self) -> None:
        for _ in range(len(self._expected)):
            waiting = self._expected.popleft()
            replies, ask, asked, topic, key = waiting
            try:
                reply = replies.try_recv()
            except zenoh.ZError:
                is_answered = False
            else:
                if reply is None:
                    self._expected.append(waiting)
                    self.has_some = True
                    continue
                is_answered = reply.ok is not None
                if is_answered and (payload := reply.ok.payload.to_bytes()) != NOTHING:
                    self.append(topic, key, payload)
            if not is_answered and asked < ASKED_MAX:
                self.expect(ask, topic, key, asked + 1)
