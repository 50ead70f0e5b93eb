"""Reading sieve: selects the motes' readings that are new, for counting, plotting and storing.

Two robots that receive one packet at the same time may both publish its reading. A reading that was fetched from a
mote's log twice also arrives twice. Mote and sequence number identify a reading until the numbers wrap around or the
mote restarts. The time of measurement distinguishes those cases.
"""

from collections import OrderedDict

from robrain.protocol.clock import to_ns
from robrain.protocol.messages.motes.mote_messages import MoteReading

SAME_NS = to_ns(5.0)
"""Two robots' words on when a reading was taken differ by their clocks and by the mote's tenths of a second."""
SAME_PER_AGE = 2e-4
"""And by the rates of these clocks, over the age of a stored reading."""


class ReadingSieve:
    """Knows the last readings that have come; the oldest of more are forgotten.

    Args:
        capacity: readings that are remembered, of all motes together.

    """

    def __init__(self, capacity: int = 1 << 16) -> None:
        self._capacity = capacity
        self._measured_ns: OrderedDict[tuple[str, int, str], int] = OrderedDict()

    def is_new(self, reading: MoteReading) -> bool:
        """Whether a reading comes for the first time; one without a sequence number always does."""
        if reading.sequence is None:
            return True
        key = (reading.mote, reading.sequence, reading.quantity)
        measured_ns = measured_at_ns(reading)
        before_ns = self._measured_ns.get(key)
        self._measured_ns[key] = measured_ns
        self._measured_ns.move_to_end(key)
        if len(self._measured_ns) > self._capacity:
            self._measured_ns.popitem(last=False)
        age_ns = max(0, reading.stamp_ns - measured_ns)
        return before_ns is None or abs(measured_ns - before_ns) > SAME_NS + SAME_PER_AGE * age_ns


def measured_at_ns(reading: MoteReading) -> int:
    """Time of a reading's measurement; the time of its message, if that is unknown or would be later."""
    return min(reading.measured_ns or reading.stamp_ns, reading.stamp_ns)
