"""Compares a run with a recording while it runs, message by message, without keeping either."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from robrain.coordinator.recording.foxglove.visual_topics import is_visual
from robrain.coordinator.recording.reader.comparing import Difference, compare_messages
from robrain.coordinator.recording.reader.reading import RecordedMessage, read_messages
from robrain.coordinator.recording.writer.run_digest import RunDigest
from robrain.protocol.wire.topic import Topic


class Sameness:
    """Follows a run, and stops at the first message that the recording has otherwise.

    Args:
        path: the recording.

    """

    def __init__(self, path: Path) -> None:
        self.difference: Difference | None = None
        """The first difference; the recording's value is the first."""
        self.messages = 0
        """Messages that were equal."""
        self._recorded = _of_the_wire(path)
        self._next = next(self._recorded, None)
        self._digest = RunDigest()

    @property
    def digest(self) -> str:
        """Digest of the recording, as far as it was compared."""
        return self._digest.hexdigest()

    def take(self, told: Sequence[tuple[Topic[Any], str, bytes, int, int]], now_ns: int) -> None:
        """Compare what one step of the run has recorded."""
        for _, key, payload, _, _ in told:
            if self.difference is not None:
                return
            recorded = self._next
            said = RecordedMessage(key, now_ns, payload, "json")
            self.difference = compare_messages(self.messages, recorded, said)
            if self.difference is not None or recorded is None:
                return
            self.messages += 1
            self._digest.add([(None, key, recorded.payload, recorded.publish_time_ns, 0)])
            self._next = next(self._recorded, None)

    def check_up_to(self, now_ns: int) -> None:
        """Note a difference if the recording has more messages until this time of the run's clock."""
        recorded = self._next
        if self.difference is None and recorded is not None and recorded.log_time_ns <= now_ns:
            self.difference = compare_messages(self.messages, recorded, None)


def _of_the_wire(path: Path) -> Iterator[RecordedMessage]:
    return (message for message in read_messages(path) if not is_visual(message.topic_key))
