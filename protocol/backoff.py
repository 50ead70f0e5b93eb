"""When to try again after failures: each one in a row makes the pause longer, up to a limit."""

FACTOR = 2.0
GROWTHS_MAX = 64
"""A greater power has no place in a float."""


def backoff_s(failures: int, first_s: float, longest_s: float, factor: float = FACTOR) -> float:
    """The pause after this number of failures in a row, at least one.

    >>> [backoff_s(failures, 0.5, 3.0) for failures in (1, 2, 3, 4, 5000)]
    [0.5, 1.0, 2.0, 3.0, 3.0]
    """
    return min(first_s * factor ** min(failures - 1, GROWTHS_MAX), longest_s)


class Backoff:
    """Counts failures in a row; times are seconds of the caller's clock.

    Args:
        first_s: pause after the first failure.
        longest_s: limit of the pause.

    """

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_s, self._longest_s = first_s, longest_s
        self.failures = 0
        """Since it last succeeded."""
        self._due_s = float("-inf")

    def is_due(self, now_s: float) -> bool:
        """Whether to try now."""
        return now_s >= self._due_s

    def wait_s(self, now_s: float) -> float:
        """Until the next try; 0 if it is due."""
        return max(self._due_s - now_s, 0.0)

    def fail(self, now_s: float) -> float:
        """Record a failure; returns the pause."""
        self.failures += 1
        pause_s = backoff_s(self.failures, self._first_s, self._longest_s)
        self._due_s = now_s + pause_s
        return pause_s

    def succeed(self) -> int:
        """Record a success; returns the number of failures before it."""
        failures, self.failures = self.failures, 0
        self._due_s = float("-inf")
        return failures
