"""Publishers of one concrete key: they stamp, number, encode and put."""

from collections.abc import Callable
from typing import Any

import msgspec

from robrain.protocol.border.border import Incoming
from robrain.protocol.clock import Clock
from robrain.protocol.links.thinning import Thinning
from robrain.protocol.messages.message import Message
from robrain.protocol.topic import Topic


class Publisher:
    """Publishes one topic under one key. Made by `Endpoint.publisher`.

    Args:
        topic: message.
        key: where.
        clock: stamps messages.
        deliver: delivers within the process, in lockstep.
        declare: declares the key to Zenoh, for other processes; None where there can be none.
        forget: called with the declaration, once it is undeclared.

    """

    def __init__(
        self,
        topic: Topic[Any],
        key: str,
        clock: Clock,
        deliver: Callable[[Incoming, str, bytes], None] | None = None,
        declare: Callable[[], Any] | None = None,
        forget: Callable[[Any], None] = lambda _: None,
    ) -> None:
        self.topic = topic
        self.key = key
        self.thinning: Thinning | None = None
        """Limit that decides whether the link has room; None sends everything."""
        self._deliver = deliver
        self._declare = declare
        self._declared: Any = declare() if declare is not None and deliver is None else None
        """In lockstep declared with the first put that others may receive: most events of most robots never happen."""
        self._clock = clock
        self._forget = forget
        self._seq = 0
        self.in_own_name: Callable[[Any], Any] | None = None
        """In a secured team, gives a message that names its sender the sender's own name."""
        self._encoder = msgspec.json.Encoder()

    def put(self, message: Message, stamp_ns: int | None = None) -> None:
        """Send a message with the next sequence number and a stamp; None stamps it with the current time.

        Raises:
            ValueError: the message is larger than its topic allows.

        """
        stamp_ns = self._clock.now_ns() if stamp_ns is None else stamp_ns
        if self.in_own_name is not None:
            message = self.in_own_name(message)
        stamped = msgspec.structs.replace(message, stamp_ns=stamp_ns, seq=self._seq)
        encoded = self._encoder.encode(stamped)
        if len(encoded) > self.topic.payloads.max_bytes:
            raise ValueError(self.topic.payloads.too_large(len(encoded)))
        if self.thinning is not None and not self.thinning.admits(self.topic, self.key, len(encoded)):
            return
        self._seq += 1
        if self._declare is not None:
            self._put_outside(self._declare, encoded)
        if self._deliver is not None:
            self._deliver(self.topic, self.key, encoded)

    def put_bytes(self, payload: bytes) -> None:
        """Send bytes as they are, on topics that carry a foreign protocol or a recorded payload."""
        if self._declare is not None:
            self._put_outside(self._declare, payload)
        if self._deliver is not None:
            self._deliver(self.topic, self.key, payload)

    def _put_outside(self, declare: Callable[[], Any], payload: bytes) -> None:
        if self._declared is None:
            self._declared = declare()
        self._declared.put(payload)

    def close(self) -> None:
        """Undeclare it before its endpoint closes; late joiners get nothing of it any more."""
        if self._declared is not None:
            self._declared.undeclare()
            self._forget(self._declared)
