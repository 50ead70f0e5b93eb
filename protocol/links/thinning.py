"""Thins a robot's telemetry at the sender, where the capacity of its link is declared.

A full link delays or drops every later message, a halt's confirmation too. Repeating messages are dropped instead:
topics of which only the latest counts and that come at a fixed rate. Each still comes often enough to keep its
deadline. Everything else is sent, and uses the link up first.
"""

import threading
from typing import Any

from robrain.protocol.clock import Clock, to_ns, to_seconds
from robrain.protocol.topic import Role, Topic

BURST_S = 1.0
"""The unused budget of the last second may be sent at once, and the debt has the same limit."""
GAP_PERIODS = 10
"""A topic without a deadline comes at least once in this number of periods."""


class Thinning:
    """Decides for one robot which messages are dropped. Any thread may ask.

    Args:
        bytes_per_s: capacity of the link for the robot's own messages; their overhead is not counted.
        clock: the run's clock.

    """

    def __init__(self, bytes_per_s: float, clock: Clock) -> None:
        if not bytes_per_s > 0:
            raise ValueError(f"expected bytes_per_s > 0, got {bytes_per_s:g}")
        self.skipped: dict[str, int] = {}
        """Messages that were dropped, by topic."""
        self._bytes_per_s = bytes_per_s
        self._burst = bytes_per_s * BURST_S
        self._room = self._burst
        self._clock = clock
        self._asked_ns = clock.now_ns()
        self._sent_ns: dict[str, int] = {}
        self._lock = threading.Lock()

    @property
    def total(self) -> int:
        """Messages that were dropped."""
        return sum(self.skipped.values())

    def admits(self, topic: Topic[Any], key: str, size: int) -> bool:
        """Whether to send a message of this many bytes now; a message that is not sent is counted."""
        with self._lock:
            now_ns = self._clock.now_ns()
            passed_s = to_seconds(max(now_ns - self._asked_ns, 0))
            self._asked_ns = now_ns
            self._room = min(self._room + passed_s * self._bytes_per_s, self._burst)
            if self._room < size and self._may_wait(topic, key, now_ns):
                self.skipped[topic.name] = self.skipped.get(topic.name, 0) + 1
                return False
            self._room = max(self._room - size, -self._burst)
            if is_thinned(topic):
                self._sent_ns[key] = now_ns
            return True

    def _may_wait(self, topic: Topic[Any], key: str, now_ns: int) -> bool:
        if not is_thinned(topic) or not topic.rate_hz:
            return False
        periods = topic.periods_max - 1 if topic.periods_max else GAP_PERIODS
        sent_ns = self._sent_ns.get(key)
        return sent_ns is not None and 0 <= now_ns - sent_ns < to_ns((periods - 0.5) / topic.rate_hz)


def is_thinned(topic: Topic[Any]) -> bool:
    """Whether messages of a topic may be dropped: the next one has the same content, and comes soon."""
    return topic.is_latest and bool(topic.rate_hz) and topic.by is Role.ROBOT
