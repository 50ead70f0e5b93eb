"""Counter: counts the seconds since the start, the paper's example of a skill that needs no hardware.

The smallest complete plugin: read it first.
"""

from typing import Protocol

from robrain.agent.plugin import Skill, external
from robrain.protocol.clock import to_seconds


class CounterInterface(Protocol):
    """Seconds that have passed."""

    def seconds(self) -> int:
        """Seconds since the start."""


class Counter(Skill):
    """Counts the seconds since it was activated."""

    interface = CounterInterface
    """Interface for other plugins."""

    def activate(self) -> None:
        # Time comes from the run's clock, never from the wall: in lockstep it is the simulated one.
        self._started_ns = self.env.clock.now_ns()

    @external
    def seconds(self) -> int:
        """Whole seconds since the start; `@external` opens it to callers outside the robot."""
        return int(to_seconds(self.env.clock.now_ns() - self._started_ns))
