"""Retry schedule with exponential backoff."""

FIRST_S = 5.0
LONGEST_S = 300.0


class Retry:
    """When to retry after failures; times are seconds of the caller's monotonic clock."""

    def __init__(self) -> None:
        self.failures = 0
        """Number of consecutive failures."""
        self._next_s = 0.0

    @property
    def failing(self) -> bool:
        """Whether the last attempt failed."""
        return self.failures > 0

    def is_due(self, now_s: float) -> bool:
        """Whether the next attempt is due."""
        return not self.failing or now_s >= self._next_s

    def wait_s(self, now_s: float) -> float:
        """Time until the next attempt; 0 if nothing failed."""
        return max(0.0, self._next_s - now_s) if self.failing else 0.0

    def fail(self, now_s: float) -> float:
        """Record a failure; returns the time until the next attempt: 5 s, doubled each time, up to 5 min."""
        pause_s = min(LONGEST_S, FIRST_S * 2.0 ** min(self.failures, 10))
        self.failures += 1
        self._next_s = now_s + pause_s
        return pause_s

    def succeed(self) -> int:
        """Record a success; returns the number of failures before it."""
        failures, self.failures = self.failures, 0
        return failures
