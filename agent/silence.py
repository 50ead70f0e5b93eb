"""How long a source has been silent, for plugins that fault when it is."""

FIRST_WORD_NS = 10_000_000_000
"""A source without a message for this long after the start is named in the log (chosen)."""
NEVER_NS = 1 << 63


class Silence:
    """Counts the silence of one source, while its plugin was awake to receive it.

    A plugin asks in each step once the source has been silent for `begins_ns`. The time since the last check counts for
    at most half of the limit. A process that was paused, on a busy machine or a slow disk, thus does not count its own
    pause as its source's silence. A plugin that runs regularly notices a silent source when the limit has passed. A
    plugin that checks more seldom notices it at its third check.

    Args:
        limit_ns: silence after which the source counts as gone.

    """

    def __init__(self, limit_ns: int) -> None:
        self.limit_ns = limit_ns
        self.begins_ns = limit_ns // 4
        """Before this there is nothing to count: plugins whose source sends do not ask."""
        self._received_ns: int | None = None
        self._silent_ns = self._asked_ns = 0

    def since(self, received_ns: int, now_ns: int) -> int:
        """Silence, in nanoseconds, of a source whose last message came at `received_ns`."""
        if received_ns != self._received_ns:
            self._received_ns, self._asked_ns, self._silent_ns = received_ns, received_ns, 0
        self._silent_ns += min(max(0, now_ns - self._asked_ns), self.limit_ns // 2)
        self._asked_ns = now_ns
        return self._silent_ns


class FirstWord:
    """Reports once that no message has arrived since the start: the source may be starting, or be absent.

    Args:
        since_ns: the start.

    """

    def __init__(self, since_ns: int) -> None:
        self._due_ns = since_ns + FIRST_WORD_NS

    def is_missing(self, now_ns: int) -> bool:
        """True once, if it is asked before the source's first message."""
        if now_ns < self._due_ns:
            return False
        self._due_ns = NEVER_NS
        return True
