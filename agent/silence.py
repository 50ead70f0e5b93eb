"""How long a source has been silent, for plugins that fault when it is."""


class Silence:
    """Counts the silence of one source, as far as its plugin was awake to hear it.

    A plugin looks in each step. What has passed since the last look counts for at most half of the limit: a process
    that stood still, on a busy machine or a slow disk, does not take its own pause for its source's silence. A silent
    source is noticed when the limit has passed for a plugin that is awake, and at the third look of one that looks more
    seldom than that.

    Args:
        limit_ns: silence after which the source counts as gone.

    """

    def __init__(self, limit_ns: int) -> None:
        self.limit_ns = limit_ns
        self._silent_ns = self._looked_ns = 0

    def heard(self, now_ns: int) -> None:
        """The source has said something, or begins to be listened to."""
        self._silent_ns, self._looked_ns = 0, now_ns

    def look(self, now_ns: int) -> int:
        """Silence so far, in nanoseconds."""
        passed_ns = max(0, now_ns - self._looked_ns)
        self._looked_ns = now_ns
        self._silent_ns += min(passed_ns, self.limit_ns // 2)
        return self._silent_ns
