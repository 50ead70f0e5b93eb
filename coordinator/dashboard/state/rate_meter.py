"""How fast a running total grows, seen over the last few seconds."""

from collections import deque


class RateMeter:
    """Growth of a total per second of the caller's clock, over a sliding window.

    Args:
        window_s: how far back the total is compared with.
    """

    def __init__(self, window_s: float = 4.0) -> None:
        if not window_s > 0:
            raise ValueError(f"expected window_s > 0, got {window_s}")
        self.window_s = window_s
        self._samples: deque[tuple[float, float]] = deque()

    def add(self, now_s: float, total: float) -> None:
        """Take a reading of the total; a total that shrank starts the meter anew."""
        if self._samples and total < self._samples[-1][1]:
            self._samples.clear()
        self._samples.append((now_s, total))
        while len(self._samples) > 2 and self._samples[1][0] <= now_s - self.window_s:
            self._samples.popleft()

    @property
    def per_s(self) -> float | None:
        """Growth per second, or None while less than half a second has been seen."""
        if not self._samples:
            return None
        first_s, first = self._samples[0]
        last_s, last = self._samples[-1]
        if last_s - first_s < 0.5:
            return None
        return (last - first) / (last_s - first_s)
