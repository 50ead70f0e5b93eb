"""Refused and lost messages: counted by topic, sender and reason, and logged at most once a minute."""

import logging
import threading
from enum import StrEnum
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.clock import Clock, to_ns
from robrain.protocol.model.ranges import Count, Name, Text
from robrain.protocol.safe_text import safe_text

logger = logging.getLogger(__name__)

LOG_EVERY_NS = to_ns(60.0)
KINDS_MAX = 256
"""Combinations of topic, sender and reason counted singly; the senders of all others are counted as `OTHERS`."""
LOGGED_MAX = 5
"""Combinations named in one line of the log."""
KEY_LENGTH = 120
REASON_LENGTH = 200
OTHERS = "others"
SHOWN = 64
"""Combinations in one message, most frequent first."""


class RefusalCode(StrEnum):
    """Why a message was refused, or a record set aside."""

    TOO_LARGE = "too_large"
    MALFORMED = "malformed"
    """It does not decode, or a number or text in it is out of range."""
    WRONG_NAME = "wrong_name"
    """Key and payload name different senders."""
    UNKNOWN_SENDER = "unknown_sender"
    NOT_PLAUSIBLE = "not_plausible"
    """It claims facts that its sender cannot know."""
    OLD_EPOCH = "old_epoch"
    """A robot refused an offer because it has accepted one of a later epoch."""
    FAILED = "failed"
    """It was accepted, but handling it raised an exception."""
    LOST = "lost"
    """It was lost for good in transit: its sender keeps too few to send it again."""


class Refusal(msgspec.Struct, frozen=True, kw_only=True):
    """How many messages of one topic and sender were refused for one reason.

    >>> one = Refusal(topic="halt", key="robrain/default/halt", code="malformed", count=2, why="no `by`")
    >>> one.words
    '2 × halt from halt (malformed): no `by`'
    """

    topic: Name
    """Name of the topic in the table, or the kind of record."""
    key: Text
    """Key of the messages, which names the sender; or the name of a record."""
    code: Name
    """The reason, a `RefusalCode`."""
    count: Count
    """Number up to now."""
    why: Text
    """Of the last message refused."""

    @property
    def words(self) -> str:
        """The refusal for people, without the root and the team of the key."""
        sender = self.key.partition("/")[2].partition("/")[2] or self.key
        if self.code == RefusalCode.LOST:
            return f"{self.count} × {self.topic} from {sender} lost: {self.why}"
        if self.code == RefusalCode.FAILED:
            return f"{self.topic} {self.key} failed {self.count} ×: {self.why}"
        return f"{self.count} × {self.topic} from {sender} ({self.code}): {self.why}"


class Refusals:
    """Counts refused messages. Thread-safe.

    Args:
        clock: the run's clock.

    """

    def __init__(self, clock: Clock) -> None:
        self.total = 0
        self.defect = ""
        """The first failure of code, in words; a lockstep run ends with it."""
        self._clock = clock
        self._found: dict[tuple[str, str, str], Refusal] = {}
        self._logged: dict[tuple[str, str, str], int] = {}
        """Counts at the time of the last log line."""
        self._reported_ns: int | None = None
        self._counting = threading.Lock()

    def record(self, topic: str, key: str, code: RefusalCode, why: str, count: int = 1) -> None:
        """Count a refused message, or several, and log if a line is due.

        Args:
            topic: name of the topic in the table.
            key: key of the message, or the name of a record.
            code: the reason.
            why: the reason in words.
            count: how many.

        """
        key = safe_text(key, KEY_LENGTH)
        with self._counting:
            self.total += count
            kind = (topic, key, str(code))
            if kind not in self._found and len(self._found) >= KINDS_MAX:
                kind = (topic, OTHERS, str(code))
            before = self._found.get(kind)
            self._found[kind] = Refusal(
                topic=topic,
                key=kind[1],
                code=kind[2],
                count=count if before is None else before.count + count,
                why=safe_text(why, REASON_LENGTH),
            )
            text = self._due(self._clock.now_ns())
        if text:
            logger.warning("%s", text)

    def record_failure(self, what: str, name: str, why: str) -> None:
        """Count a failure of code that something else stands in for: of a replaceable part, or of a stage of a step.

        Args:
            what: the kind of part in one word.
            name: its name.
            why: the error in words, with the line of its file.

        """
        self.defect = self.defect or f"{what.replace('_', ' ')} {name} failed: {why}"
        self.record(what, name, RefusalCode.FAILED, why)

    def counts(self, most: int | None = None) -> list[Refusal]:
        """All refusals up to now, or the `most` frequent ones, largest count first."""
        if not self.total:
            return []
        with self._counting:
            return sorted(self._found.values(), key=lambda one: (-one.count, one.topic, one.key, one.code))[:most]

    def _due(self, now_ns: int) -> str:
        """The line to log now; empty within a minute of the last one."""
        if self._reported_ns is not None and 0 <= now_ns - self._reported_ns < LOG_EVERY_NS:
            return ""
        self._reported_ns = now_ns
        fresh = [
            (one.count - self._logged.get(kind, 0), one)
            for kind, one in self._found.items()
            if one.count > self._logged.get(kind, 0)
        ]
        self._logged = {kind: one.count for kind, one in self._found.items()}
        fresh.sort(key=lambda pair: -pair[0])
        named = [f"{count} of {one.topic} ({one.key}), {one.code}: {one.why}" for count, one in fresh[:LOGGED_MAX]]
        more = f"; and of {len(fresh) - LOGGED_MAX} other kinds" if len(fresh) > LOGGED_MAX else ""
        return f"refused or lost messages: {'; '.join(named)}{more}"


Refused = Annotated[list[Refusal], Meta(max_length=1000)] | msgspec.UnsetType
"""Refusals of a component, largest count first; absent if there are none."""


def most_refused(refusals: Refusals, most: int = SHOWN) -> Refused:
    """The `most` frequent refusals of a component, for a message."""
    return refusals.counts(most) or msgspec.UNSET
