"""Messages that were refused at the border: counted by topic, sender and reason, and told at most once a minute."""

import logging
import threading
from enum import StrEnum

import msgspec

from robrain.protocol.model.ranges import Count, Name, Text
from robrain.protocol.wire.clock import Clock, to_ns
from robrain.protocol.wire.safe_text import safe_text

logger = logging.getLogger(__name__)

TELL_NS = to_ns(60.0)
KINDS_MAX = 256
"""Combinations of topic, sender and reason that are told apart; all others are counted together."""
TOLD_MAX = 5
"""Combinations that one line of the log names."""
KEY_LENGTH = 120
WHY_LENGTH = 200
OTHERS = "others"


class RefusalCode(StrEnum):
    """Why a message was refused, or a record set aside."""

    TOO_LARGE = "too_large"
    MALFORMED = "malformed"
    """It does not decode, or a number or text of it is out of its range."""
    WRONG_NAME = "wrong_name"
    """Its key names another sender than its payload."""
    UNKNOWN_SENDER = "unknown_sender"
    NOT_PLAUSIBLE = "not_plausible"
    """It claims what its sender cannot know."""
    OLD_EPOCH = "old_epoch"
    """A robot refuses an offer, for it knows a greater epoch than the coordinator gives."""
    FAILED = "failed"
    """It was taken in, and handling it raised."""


class Refusal(msgspec.Struct, frozen=True, kw_only=True):
    """How many messages of one topic and sender were refused for one reason."""

    topic: Name
    key: Text
    """Names the sender; a record's name if it is no message."""
    code: Name
    count: Count
    why: Text
    """Of the last one."""


class Refusals:
    """Counts what was refused. May be used on any thread.

    Args:
        clock: of the run.

    """

    def __init__(self, clock: Clock) -> None:
        self.total = 0
        self._clock = clock
        self._found: dict[tuple[str, str, str], Refusal] = {}
        self._told: dict[tuple[str, str, str], int] = {}
        """The count of each when the log told of it last."""
        self._told_ns: int | None = None
        self._counting = threading.Lock()

    def note(self, topic: str, key: str, code: RefusalCode, why: str) -> None:
        """A message of this key was refused.

        Args:
            topic: its name in the table.
            key: of the message; or the name of a record.
            code: the reason.
            why: in words.

        """
        key = safe_text(key, KEY_LENGTH)
        with self._counting:
            self.total += 1
            kind = (topic, key, str(code))
            if kind not in self._found and len(self._found) >= KINDS_MAX:
                kind = (topic, OTHERS, str(code))
            before = self._found.get(kind)
            self._found[kind] = Refusal(
                topic=topic,
                key=kind[1],
                code=kind[2],
                count=1 if before is None else before.count + 1,
                why=safe_text(why, WHY_LENGTH),
            )
            text = self._due(self._clock.now_ns())
        if text:
            logger.warning("%s", text)

    def counts(self) -> list[Refusal]:
        """All that was refused so far, most first."""
        with self._counting:
            return sorted(self._found.values(), key=lambda one: (-one.count, one.topic, one.key, one.code))

    def _due(self, now_ns: int) -> str:
        """What the log is to say now; empty if it has spoken within the last minute."""
        if self._told_ns is not None and 0 <= now_ns - self._told_ns < TELL_NS:
            return ""
        self._told_ns = now_ns
        fresh = [
            (one.count - self._told.get(kind, 0), one)
            for kind, one in self._found.items()
            if one.count > self._told.get(kind, 0)
        ]
        self._told = {kind: one.count for kind, one in self._found.items()}
        fresh.sort(key=lambda pair: -pair[0])
        named = [f"{count} of {one.topic} ({one.key}), {one.code}: {one.why}" for count, one in fresh[:TOLD_MAX]]
        more = f"; and of {len(fresh) - TOLD_MAX} other kinds" if len(fresh) > TOLD_MAX else ""
        return f"refused messages: {'; '.join(named)}{more}"
