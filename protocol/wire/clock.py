"""Time, passed in: the wall's in live runs, the runner's in lockstep."""

import time
from collections.abc import Callable
from functools import partial
from typing import Protocol

NS_PER_S = 1_000_000_000


class Clock(Protocol):
    """Tells the time of a run."""

    def now_ns(self) -> int:
        """Nanoseconds: since the start of the run in lockstep, since 1970 in live."""
        ...


class WallClock:
    """The clock of the live drive."""

    def now_ns(self) -> int:
        """Nanoseconds since 1970, UTC."""
        return time.time_ns()


class VirtualClock:
    """The clock of the lockstep drive: stands still until it is moved."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = [start_ns]
        self.now_ns: Callable[[], int] = partial(self._now_ns.__getitem__, 0)
        """Nanoseconds since the start of the run; no Python function, as each robot asks hundreds of times a second."""

    def advance_to(self, now_ns: int) -> None:
        """Move on to `now_ns`; time never runs backwards (ValueError)."""
        if now_ns < self._now_ns[0]:
            raise ValueError(f"time would run backwards: {now_ns} ns after {self._now_ns[0]} ns")
        self._now_ns[0] = now_ns


def to_seconds(duration_ns: int) -> float:
    """Nanoseconds as seconds."""
    return duration_ns / NS_PER_S


def to_ns(duration_s: float) -> int:
    """Seconds as whole nanoseconds."""
    return round(duration_s * NS_PER_S)
