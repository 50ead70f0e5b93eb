"""When to try again what has failed: soon at first, then ever more seldom."""

FIRST_S = 5.0
LONGEST_S = 300.0


class Retry:
    """Times are of the caller's steady clock, seconds."""

    def __init__(self) -> None:
        self.failures = 0
        """In a row."""
        self._next_s = 0.0

    @property
    def failing(self) -> bool:
        """Whether the last try failed."""
        return self.failures > 0

    def is_due(self, now_s: float) -> bool:
        """Whether to try."""
        return not self.failing or now_s >= self._next_s

    def wait_s(self, now_s: float) -> float:
        """Time until the next try."""
        return max(0.0, self._next_s - now_s) if self.failing else 0.0

    def fail(self, now_s: float) -> float:
        """A try failed; returns the time until the next one: 5 s, and each time twice as long, up to 5 min."""
        pause_s = min(LONGEST_S, FIRST_S * 2.0 ** min(self.failures, 10))
        self.failures += 1
        self._next_s = now_s + pause_s
        return pause_s

    def succeed(self) -> int:
        """A try succeeded; returns how many failed before it."""
        failures, self.failures = self.failures, 0
        return failures
