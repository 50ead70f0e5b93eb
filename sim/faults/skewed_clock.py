"""The clock of one process, which may differ from the run's."""

from robrain.protocol.wire.clock import Clock


class SkewedClock:
    """The run's clock, and a difference.

    Args:
        clock: of the run.
        skew_ns: how far it is ahead.

    """

    def __init__(self, clock: Clock, skew_ns: int = 0) -> None:
        self.skew_ns = skew_ns
        self._clock = clock

    def now_ns(self) -> int:
        """See Clock; never below 0."""
        return max(0, self._clock.now_ns() + self.skew_ns)
