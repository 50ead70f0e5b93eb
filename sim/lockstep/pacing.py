"""Pacing and interrupting a lockstep run: the only places where it touches the wall clock and the terminal."""

import signal
import threading
import time
from types import FrameType, TracebackType
from typing import Self


class Pacer:
    """Holds a run back to a multiple of real time.

    Args:
        speed: simulated seconds a second; 0 for as fast as it goes.

    """

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._started_s = time.perf_counter()

    @property
    def wall_time_s(self) -> float:
        """Time since the pacer was made."""
        return time.perf_counter() - self._started_s

    def wait(self, sim_time_s: float) -> None:
        """Wait until the wall clock has come as far; a run that is slower than wanted is not made up for."""
        if self._speed <= 0:
            return
        ahead_s = sim_time_s / self._speed - self.wall_time_s
        if ahead_s > 0:
            time.sleep(ahead_s)
        else:
            self._started_s -= ahead_s


class StopOnInterrupt:
    """Context in which Ctrl-C and SIGTERM ask the run, or its set-up, to stop instead of raising in the middle of it.

    An exception in the middle of a direct Zenoh callback would be swallowed, and with it the interrupt. A second Ctrl-C
    is let through. Outside of the main thread it has no effect.
    """

    def __init__(self) -> None:
        self.requested = False
        self._before: dict[int, object] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._request)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type] # `object`, but returned by signal.signal

    def _request(self, number: int, _frame: FrameType | None) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
