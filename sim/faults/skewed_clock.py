"""The clock that one process reads, which may differ from the run's."""

from robrain.protocol.wire.clock import Clock


class SkewedClock:
    """The run's clock, and a difference.

    Args:
        clock: of the run.

    """

    def __init__(self, clock: Clock) -> None:
        self.skew_ns = 0
        """How far it is ahead."""
        self._clock = clock

    def now_ns(self) -> int:
        """See Clock; it may jump, forwards and back, but is never below 0."""
        return max(0, self._clock.now_ns() + self.skew_ns)
