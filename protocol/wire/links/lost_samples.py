"""Samples of lossless topics that were lost for good: counted by the key that their sender put last."""

from typing import Any

import zenoh
from zenoh import ext

from robrain.protocol.wire.border.border import Border
from robrain.protocol.wire.topic import Topic

SENDERS_MAX = 4096
"""Senders whose keys are kept; samples that one of the others lost are counted under the selector."""


class LostSamples:
    """Follows one subscription; called on Zenoh's threads.

    Args:
        topic: what is heard.
        selector: the keys that are subscribed to.
        border: counts what was lost.

    """

    def __init__(self, topic: Topic[Any], selector: str, border: Border) -> None:
        self._topic = topic
        self._selector = selector
        self._border = border
        self._keys: dict[tuple[str, int], str] = {}

    def note_sender(self, sample: zenoh.Sample, key: str) -> None:
        """Remember whose key it is: a miss only tells which publisher it was."""
        source = sample.source_info
        if source is not None and len(self._keys) < SENDERS_MAX:
            self._keys[_publisher(source.source_id)] = key

    def missed(self, miss: ext.Miss) -> None:
        """Count what a publisher sent and no recovery has brought."""
        key = self._keys.get(_publisher(miss.source), self._selector)
        self._border.note_lost(self._topic, key, miss.nb)


def _publisher(source: zenoh.EntityGlobalId) -> tuple[str, int]:
    return str(source.zid), source.eid
