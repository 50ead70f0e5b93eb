"""What the counter offers."""

from typing import Protocol


class CounterInterface(Protocol):
    """Seconds that have passed."""

    def seconds(self) -> int:
        """Seconds since the start."""
