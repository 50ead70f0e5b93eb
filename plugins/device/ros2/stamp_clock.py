"""Times of measurement on the robot's clock, from stamps that other computers give by theirs.

If the stamps are by the robot's clock, they are the times of measurement. If they are by another one, as that of a
computer that is not synchronised or of a simulator, the offset is the least delay of recent messages, because delays
only increase it (Moon, Skelly, Towsley: Estimation and removal of clock skew from network delay measurements, 1999).
"""

from robrain.protocol.wire.clock import NS_PER_S, to_ns

LATENCY_MAX_NS = to_ns(0.5)
"""Messages that all come later after their stamps are stamped by another clock."""
AHEAD_MAX_NS = to_ns(0.005)
"""Likewise those with stamps so far in the future; synchronised clocks differ by less."""
WINDOW = 256
"""Messages of a window; the least delay is that of the current window and the one before."""
ANEW_NS = 3 * NS_PER_S
"""A delay greater by this is no delay: the other clock has been set, or its process started again."""


class StampClock:
    """Converts the stamps of one publisher."""

    def __init__(self) -> None:
        self._count = 0
        self._least_ns: int | None = None
        self._before_ns: int | None = None

    def measured_ns(self, stamp_ns: int, arrived_ns: int) -> int:
        """The time of measurement, robot's clock, never after arrival.

        Args:
            stamp_ns: the message's; 0 if it has none.
            arrived_ns: when it came, robot's clock.

        """
        if stamp_ns <= 0:
            return arrived_ns
        delay_ns = arrived_ns - stamp_ns
        offset_ns = self._observe(delay_ns)
        if -AHEAD_MAX_NS <= offset_ns <= LATENCY_MAX_NS:
            return min(stamp_ns, arrived_ns)
        return min(stamp_ns + offset_ns, arrived_ns)

    def _observe(self, delay_ns: int) -> int:
        least_ns = self._least_ns
        if least_ns is None or delay_ns - self._offset_ns(least_ns) > ANEW_NS:
            self._count, self._before_ns = 0, None
            least_ns = delay_ns
        elif self._count == WINDOW:
            self._count, self._before_ns = 0, least_ns
            least_ns = delay_ns
        self._count += 1
        self._least_ns = min(least_ns, delay_ns)
        return self._offset_ns(self._least_ns)

    def _offset_ns(self, least_ns: int) -> int:
        return least_ns if self._before_ns is None else min(least_ns, self._before_ns)
