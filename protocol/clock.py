"""Time, passed in: a monotonic clock in live runs, the runner's in lockstep."""

import time
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Protocol

NS_PER_S = 1_000_000_000
AHEAD_S = 5.0
"""A stamp that is farther ahead of the receiver's clock than this is by a clock that differs (chosen)."""
BEHIND_S = 60.0
"""Likewise a stamp that is farther behind; messages of a slow network are delayed by less."""
_ELAPSED = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""Counts while the machine is suspended, too, where the system has such a clock."""


class Clock(Protocol):
    """Returns the time of a run."""

    def now_ns(self) -> int:
        """Nanoseconds: since the start of the run in lockstep, since 1970 in live."""
        ...


class LiveClock:
    """The clock of the live drive: monotonic, independent of the machine's wall clock.

    Args:
        offset_ns: the time since 1970 less that of the monotonic clock; None for that at the start of this process.

    """

    def __init__(self, offset_ns: int | None = None) -> None:
        self.offset_ns = _wall_offset_ns() if offset_ns is None else offset_ns

    def now_ns(self) -> int:
        """Nanoseconds since 1970, UTC, by the wall clock at the start of the process."""
        return time.clock_gettime_ns(_ELAPSED) + self.offset_ns

    def of_wall_ns(self, wall_ns: int) -> int:
        """The time by this clock at which the machine's wall clock has shown `wall_ns`, if it was not set since."""
        return self.now_ns() - (time.time_ns() - wall_ns)


@cache
def _wall_offset_ns() -> int:
    return time.time_ns() - time.clock_gettime_ns(_ELAPSED)


class VirtualClock:
    """The clock of the lockstep drive: it advances only when it is moved."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = [start_ns]
        self.now_ns: Callable[[], int] = partial(self._now_ns.__getitem__, 0)
        """Nanoseconds since the start of the run; no Python function, as each robot asks hundreds of times a second."""

    def advance_to(self, now_ns: int) -> None:
        """Move on to `now_ns`; time never runs backwards (ValueError)."""
        if now_ns < self._now_ns[0]:
            raise ValueError(f"time would run backwards: {now_ns} ns after {self._now_ns[0]} ns")
        self._now_ns[0] = now_ns


def steps(should_stop: Callable[[], bool], period_s: float) -> Iterator[None]:
    """The steps of a live loop: one a period until `should_stop()`. A step that takes longer delays the next."""
    while not should_stop():
        began_s = time.monotonic()
        yield
        time.sleep(max(period_s - (time.monotonic() - began_s), 0.0))


def to_seconds(duration_ns: int) -> float:
    """Nanoseconds as seconds."""
    return duration_ns / NS_PER_S


def to_ns(duration_s: float) -> int:
    """Seconds as whole nanoseconds."""
    return round(duration_s * NS_PER_S)


def clock_difference_ns(stamp_ns: int, now_ns: int) -> int:
    """How far a sender's clock is ahead of the receiver's: 0 unless the clocks differ.

    The clock of a machine may be wrong, or be set after some processes have started. Each message shows the difference
    again; its delay on the network counts as part of it.

    Args:
        stamp_ns: time of sending, sender's clock; 0 if unknown.
        now_ns: time of arrival, receiver's clock.

    """
    ahead_ns = stamp_ns - now_ns
    return ahead_ns if stamp_ns and not -BEHIND_S * NS_PER_S <= ahead_ns <= AHEAD_S * NS_PER_S else 0
