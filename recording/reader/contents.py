"""The content of a recording: rates, gaps and bytes per key, and its origin. Reads all of it once."""

from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from robrain.protocol.clock import NS_PER_S
from robrain.protocol.messages.robots.plugin_messages import ROBOT_LOG
from robrain.protocol.messages.robots.robot_messages import ROBOT_PATH
from robrain.protocol.topic import Role, Topic
from robrain.recording.provenance import HOST_METADATA, MANIFESTS_METADATA, RUN_METADATA, VERSIONS_METADATA
from robrain.recording.reader.reading import RecordingInfo, read_front, read_messages, recording_info
from robrain.recording.reader.recorded_message import RecordedMessage, topic_named_by

OnProgress = Callable[[float], None]


def half(on_progress: OnProgress | None, first: float) -> OnProgress | None:
    """For one half of the work, which begins at the share `first`."""
    return None if on_progress is None else lambda share: on_progress(first + share / 2)


SILENT_PERIODS = 5.0
"""A key has a gap if it is silent for this number of its mean periods, and for a second."""
SILENT_S = 1.0


class KeyContents(msgspec.Struct, frozen=True, kw_only=True):
    """The messages of one key."""

    key: str
    topic: str
    """Name in the table of topics; empty for channels that are not of the wire."""
    messages: int
    bytes: int
    """Of their payloads."""
    first_s: float
    """Seconds since the first message of the recording."""
    last_s: float
    rate_hz: float
    """Between the first and the last; 0 with fewer than two."""
    longest_gap_s: float
    longest_gap_at_s: float
    gaps: int
    """Silences between two messages of more than a second and five mean periods."""
    missing: int
    """Messages that are missing by the sender's numbers; unknown if a key has several senders."""


class RecordingContents(msgspec.Struct, frozen=True, kw_only=True):
    """The content of a recording."""

    info: RecordingInfo
    keys: list[KeyContents]
    """By name."""
    run: dict[str, str]
    """Scenario, seed, drive, team; empty when it was not robrain that made it."""
    versions: dict[str, str]
    host: dict[str, str]
    """The machine that recorded."""
    summary: dict[str, str]
    """Summary of its recorder at the end; empty when the end is missing."""
    attachments: dict[str, int]
    """Bytes of each."""
    manifests: list[str]
    """Which files of the robots and of their plugins are in it."""


def read_contents(path: Path, on_progress: OnProgress | None = None) -> RecordingContents:
    """Read a recording and list its contents.

    Raises:
        RecordingError: there is no such file, it is no recording, or it is damaged.
    """
    info = recording_info(path)
    metadata, attachments = read_front(path)
    tallies: dict[str, _Tally] = {}
    for message in read_messages(path, on_progress):
        tally = tallies.get(message.topic_key)
        if tally is None:
            tally = tallies[message.topic_key] = _Tally()
        tally.add(message)
    return RecordingContents(
        info=info,
        keys=[tallies[key].contents(key, info.start_ns) for key in sorted(tallies)],
        run=metadata.get(RUN_METADATA, {}),
        versions=metadata.get(VERSIONS_METADATA, {}),
        host=metadata.get(HOST_METADATA, {}),
        summary=info.summary,
        attachments={name: len(data) for name, data in attachments.items()},
        manifests=[name for name in metadata.get(MANIFESTS_METADATA, {}).get("names", "").split(", ") if name],
    )


def has_several_senders(topic: Topic[Any]) -> bool:
    """Whether a key may have several senders, each with its own numbers: robots of a mote, operators of a halt."""
    return topic.by is Role.OPERATOR or (topic.by is Role.ROBOT and "robot" not in topic.fields)


def has_numbers(topic: Topic[Any]) -> bool:
    """Whether the numbers under a key can be followed: not where plugins of a robot count there, each for itself."""
    return topic not in (ROBOT_PATH, ROBOT_LOG)


class _Tally:
    """Collects the messages of one key."""

    def __init__(self) -> None:
        self.bytes = 0
        self.times_ns = array("Q")
        self.sequences = array("Q")

    def add(self, message: RecordedMessage) -> None:
        self.bytes += len(message.payload)
        self.times_ns.append(message.log_time_ns)
        self.sequences.append(message.sequence)

    def contents(self, key: str, start_ns: int) -> KeyContents:
        topic = topic_named_by(key)
        times_s = (np.array(self.times_ns, np.uint64).astype(np.float64) - float(start_ns)) / NS_PER_S
        sequences = np.array(self.sequences, np.int64)
        # A sender that begins again at 0 was restarted; no message is missing then.
        missing = np.where(sequences[1:] > 0, np.diff(sequences) - 1, 0)
        # The wall's clock may have been set back in between.
        span_s = float(times_s.max() - times_s.min())
        period_s = span_s / (len(times_s) - 1) if len(times_s) > 1 else 0.0
        silences_s = np.diff(times_s)
        longest = int(silences_s.argmax()) if silences_s.size else 0
        return KeyContents(
            key=key,
            topic=topic.name if topic is not None else "",
            messages=len(times_s),
            bytes=self.bytes,
            first_s=float(times_s.min()),
            last_s=float(times_s.max()),
            rate_hz=1.0 / period_s if period_s else 0.0,
            longest_gap_s=max(float(silences_s[longest]), 0.0) if silences_s.size else 0.0,
            longest_gap_at_s=float(times_s[longest]),
            gaps=int((silences_s > max(SILENT_S, SILENT_PERIODS * period_s)).sum()),
            missing=0
            if topic is None or has_several_senders(topic) or not has_numbers(topic)
            else int(missing.clip(min=0).sum()),
        )
