"""One message out of a recording, and its decoded form."""

from functools import lru_cache
from typing import Any, NamedTuple

from robrain.protocol.border.border import Received
from robrain.protocol.table.topics import topic_of
from robrain.protocol.topic import Topic


class RecordedMessage(NamedTuple):
    """One message out of a recording."""

    topic_key: str
    """The key it had on the wire, its team included."""
    log_time_ns: int
    """The run's clock when it was recorded."""
    payload: bytes
    encoding: str
    """Encoding of the channel, `json` for our own messages."""
    publish_time_ns: int = 0
    """The sender's stamp, or the time of recording where it gave none."""
    sequence: int = 0
    """The sender's number of the message, modulo 2**32."""


parsed_key = lru_cache(maxsize=4096)(topic_of)
"""The topic of a key and the names in it, as `topic_of`; not to be written to."""


def topic_named_by(key: str) -> Topic[Any] | None:
    """The topic of a key; None for a key that is not of the wire."""
    found = parsed_key(key)
    return None if found is None else found[0]


def received(recorded: RecordedMessage) -> Received | None:
    """The message as its receivers had it; None for one without a type, and for one that does not decode."""
    found = parsed_key(recorded.topic_key)
    if found is None or found[0].message is None:
        return None
    topic, names = found
    message = topic.payloads.read_if_valid(recorded.payload)
    return None if message is None else Received(topic, recorded.topic_key, names, message)
