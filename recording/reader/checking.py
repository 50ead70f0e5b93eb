"""Checks of a recording: messages that decode, stamps that grow, numbers without holes.

With that, whether the run kept its invariants (`recording/invariants/`).
"""

from collections import Counter
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Any

import msgspec

from robrain.protocol.clock import to_ns, to_seconds
from robrain.protocol.codec import BadPayload
from robrain.protocol.messages.maps.map_messages import MapPatch
from robrain.protocol.topic import JSON, Topic
from robrain.recording.foxglove.visual_topics import is_visual
from robrain.recording.invariants.invariant import UNKNOWN_SURROUNDINGS, Ruling, Surroundings
from robrain.recording.invariants.judging import Judging, broken
from robrain.recording.provenance import SUMMARY_METADATA
from robrain.recording.reader.contents import has_numbers, has_several_senders
from robrain.recording.reader.reading import read_messages, recording_info
from robrain.recording.reader.recorded_message import RecordedMessage, topic_named_by

LISTED_OF_A_KIND = 5
"""Findings of one kind and key that are listed one by one; the rest is counted."""


class Severity(StrEnum):
    """Severity of a finding."""

    PROBLEM = "problem"
    """The recording fails a check."""
    REMARK = "note"
    """Worth knowing, and may be right."""


JUMP_S = 60.0
"""A longer time between two messages is a jump: coordinator and robots send every second."""


class CheckKind(StrEnum):
    """The kind of a finding."""

    TRUNCATED = "truncated"
    MALFORMED = "malformed"
    """A payload that does not fit its topic."""
    STAMP_BACK = "stamp_back"
    """A sender's stamp before the one before."""
    TIME_BACK = "time_back"
    """A time of recording before the one before."""
    TIME_JUMP = "time_jump"
    """A time of recording long after the one before."""
    GAP = "gap"
    """Numbers of a sender that are missing."""
    RESTART = "restart"
    """A sender's numbers began again."""
    COUNT = "count"
    """The file's own counts differ from its content."""
    LOST = "lost"
    """The recorder reports that it could not write everything."""
    UNKNOWN_KEY = "unknown_key"
    """A key that is of no recorded topic."""
    PROVENANCE = "provenance"
    """It has no description of its run."""


class RecordingFinding(msgspec.Struct, frozen=True, kw_only=True):
    """One thing that was found."""

    severity: Severity
    kind: CheckKind
    key: str
    time_s: float
    """Since the first message; 0 for a finding of the whole file."""
    text: str


class Verdict(msgspec.Struct, frozen=True, kw_only=True, rename={"remarks": "notes"}):
    """All that a check found."""

    path: Path
    messages: int
    problems: int
    remarks: int
    findings: list[RecordingFinding]
    """The first few of each kind and key, in order."""
    more: dict[str, int]
    """Number of further findings of each kind that are not listed."""
    invariants: list[Ruling] = []
    """Verdict on each invariant of the run."""

    @property
    def good(self) -> bool:
        """Whether no check failed and no invariant is broken; notes are not failures."""
        return self.problems == 0 and not broken(self.invariants)


def check_recording(
    path: Path,
    on_progress: Callable[[float], None] | None = None,
    surroundings: Surroundings = UNKNOWN_SURROUNDINGS,
) -> Verdict:
    """Check a recording from its first message to its last, and judge the invariants of its run.

    Args:
        path: an MCAP file.
        on_progress: called now and then with the share of the file that has been read, 0 to 1.
        surroundings: data on the place of the run that the recording does not have.

    Raises:
        RecordingError: there is no such file, it is no recording, or it is damaged.
    """
    info = recording_info(path)
    check = _Check(info.start_ns, Judging(surroundings, info.start_ns))
    if info.truncated:
        check.add(CheckKind.TRUNCATED, "", 0, "its end is missing: `robrain recover` makes it whole")
    if info.counts and not any(is_visual(key) or topic_named_by(key) for key in info.counts):
        check.add(CheckKind.PROVENANCE, "", 0, "no key is a topic of robrain: another program recorded it")
    elif not info.versions:
        check.add(CheckKind.PROVENANCE, "", 0, "it does not say which software made it", Severity.REMARK)
    for message in read_messages(path, on_progress):
        check.handle(message)
    if not info.truncated:
        check.compare_counts(info.counts, info.summary)
    return Verdict(
        path=path,
        messages=sum(check.counts.values()),
        problems=check.severities[Severity.PROBLEM],
        remarks=check.severities[Severity.REMARK],
        findings=check.findings,
        more={kind: count for kind, count in check.unlisted.items() if count},
        invariants=check.judging.finish(),
    )


class _Check:
    def __init__(self, start_ns: int, judging: Judging) -> None:
        self.judging = judging
        self.findings: list[RecordingFinding] = []
        self.severities: Counter[Severity] = Counter()
        self.unlisted: Counter[str] = Counter()
        self.counts: Counter[str] = Counter()
        self._start_ns = start_ns
        self._reported: Counter[tuple[CheckKind, str]] = Counter()
        self._last: dict[str, RecordedMessage] = {}
        self._last_ns: int | None = None
        self._unknown: set[str] = set()

    def add(self, kind: CheckKind, key: str, at_ns: int, text: str, severity: Severity = Severity.PROBLEM) -> None:
        self.severities[severity] += 1
        self._reported[kind, key] += 1
        if self._reported[kind, key] > LISTED_OF_A_KIND:
            self.unlisted[kind.value] += 1
            return
        time_s = to_seconds(at_ns - self._start_ns) if at_ns else 0.0
        self.findings.append(RecordingFinding(severity=severity, kind=kind, key=key, time_s=time_s, text=text))

    def handle(self, message: RecordedMessage) -> None:
        key, now_ns = message.topic_key, message.log_time_ns
        self.counts[key] += 1
        if self._last_ns is not None and now_ns < self._last_ns:
            by_s = to_seconds(self._last_ns - now_ns)
            self.add(CheckKind.TIME_BACK, key, now_ns, f"recorded {by_s:g} s before the message before it")
        elif self._last_ns is not None and now_ns - self._last_ns > to_ns(JUMP_S):
            by_s = to_seconds(now_ns - self._last_ns)
            text = f"recorded {by_s:.0f} s after the message before it: its clock was set, or the recorder stood still"
            self.add(CheckKind.TIME_JUMP, key, now_ns, text)
        self._last_ns = now_ns
        if is_visual(key):
            return
        topic = self._topic_of(key, now_ns)
        if topic is None:
            return
        decoded = self._decode(topic, message)
        self.judging.handle(decoded, now_ns)
        if isinstance(decoded, MapPatch) and decoded.parts and not message.sequence:
            return  # the answer to a query for a whole map: it is recorded in between, without a number
        sender = f"{key} {_sender_of(decoded)}" if has_several_senders(topic) else key
        before = self._last.get(sender)
        self._last[sender] = message
        # Bytes of others carry no stamps and numbers of ours.
        if before is not None and topic.encoding == JSON:
            self._check_order(before, message, has_numbers=has_numbers(topic))

    def compare_counts(self, counts: dict[str, int], summary: dict[str, str]) -> None:
        for key in sorted(counts.keys() | self.counts.keys()):
            if counts.get(key, 0) != self.counts[key]:
                text = f"its index says {counts.get(key, 0)} messages, there are {self.counts[key]}"
                self.add(CheckKind.COUNT, key, 0, text)
        if not summary:
            self.add(CheckKind.PROVENANCE, "", 0, f"it has no metadata {SUMMARY_METADATA}", Severity.REMARK)
            return
        written = sum(count for key, count in self.counts.items() if not is_visual(key))
        lost, dropped = int(summary.get("lost", 0)), int(summary.get("dropped", 0))
        if lost or dropped:
            text = f"its recorder could not write {lost} messages and had no room for {dropped}"
            self.add(CheckKind.LOST, "", 0, text)
        if "part" not in summary and int(summary.get("messages", written)) - lost != written:
            text = f"its recorder says {summary['messages']} messages, there are {written}"
            self.add(CheckKind.COUNT, "", 0, text)

    def _topic_of(self, key: str, now_ns: int) -> Topic[Any] | None:
        topic = topic_named_by(key)
        if topic is not None and topic.recorded:
            return topic
        if key not in self._unknown:
            self._unknown.add(key)
            self.add(CheckKind.UNKNOWN_KEY, key, now_ns, "a key of no recorded topic", Severity.REMARK)
        return None

    def _decode(self, topic: Topic[Any], message: RecordedMessage) -> Any:
        if topic.message is None:
            return None
        try:
            return topic.payloads.read(message.payload)
        except BadPayload as error:
            text = f"is malformed: {error}"
            self.add(CheckKind.MALFORMED, message.topic_key, message.log_time_ns, text)
            return None

    def _check_order(self, before: RecordedMessage, message: RecordedMessage, *, has_numbers: bool) -> None:
        key, now_ns = message.topic_key, message.log_time_ns
        if message.publish_time_ns < before.publish_time_ns:
            by_s = to_seconds(before.publish_time_ns - message.publish_time_ns)
            self.add(CheckKind.STAMP_BACK, key, now_ns, f"its stamp is {by_s:g} s before the one before")
        if not has_numbers:
            return
        missing = message.sequence - before.sequence - 1
        if message.sequence < before.sequence:
            text = f"its sender counts again from {message.sequence}, after {before.sequence}"
            self.add(CheckKind.RESTART, key, now_ns, text, Severity.REMARK)
        elif missing > 0:
            text = f"{missing} of its sender's messages are missing, {before.sequence + 1} to {message.sequence - 1}"
            self.add(CheckKind.GAP, key, now_ns, text)


def _sender_of(message: Any) -> str:
    return str(getattr(message, "via", "") or getattr(message, "by", ""))
