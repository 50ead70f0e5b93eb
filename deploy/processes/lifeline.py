"""The pipe from a process to the one that supervises it: beats of its main loop, and that it is ready.

The supervisor passes the write end of a pipe, whose file descriptor is in ROBRAIN_LIFELINE. The process writes a byte
whenever its main loop asks whether to stop, a few times a second at the most, so a loop that hangs is silent. A pipe
that nobody reads any more means that the supervisor has gone.
"""

import os
import time
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

LIFELINE_VARIABLE = "ROBRAIN_LIFELINE"
BEAT_S = 0.1
"""Time between two beats, at least."""
BEAT, READY = b".", b"!"
READ_BYTES = 4096


class Lifeline:
    """The end of the process that is supervised; does nothing in one that is not.

    Args:
        monotonic_s: the clock, in seconds.

    """

    def __init__(self, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self.is_cut = False
        """Whether the supervisor has gone."""
        self._monotonic_s = monotonic_s
        self._next_beat_s = float("-inf")
        # Taken out of the environment: processes that this one starts must not beat for it.
        text = os.environ.pop(LIFELINE_VARIABLE, "")
        self._file = int(text) if text.isdigit() else -1
        try:
            if self._file >= 0:
                os.set_inheritable(self._file, False)
                os.set_blocking(self._file, False)
        except OSError:  # the variable is a leftover of another process's
            self._file = -1

    def beat(self) -> None:
        """Say that the main loop goes on."""
        if self._file >= 0 and self._monotonic_s() >= self._next_beat_s:
            self._next_beat_s = self._monotonic_s() + BEAT_S
            self._write(BEAT)

    def ready(self) -> None:
        """Say that the process does its work."""
        if self._file >= 0:
            self._write(READY)

    def _write(self, what: bytes) -> None:
        try:
            with suppress(BlockingIOError):  # the supervisor hangs, and has beats enough to read
                os.write(self._file, what)
        except OSError:
            os.close(self._file)
            self._file, self.is_cut = -1, True


class Pulse(NamedTuple):
    """What has come through a lifeline since it was last read."""

    beats: int
    is_ready: bool


class LifelineEnd:
    """The supervisor's end.

    The write end is passed to one process: `pass_on` is its number until `passed`.
    """

    def __init__(self) -> None:
        self._read, self.pass_on = os.pipe()
        os.set_blocking(self._read, False)

    def passed(self) -> None:
        """The process has its end: close ours of it."""
        if self.pass_on >= 0:
            os.close(self.pass_on)
            self.pass_on = -1

    def pulse(self) -> Pulse:
        """What has come since the last call."""
        said = b""
        if self._read >= 0:
            with suppress(BlockingIOError):
                while got := os.read(self._read, READ_BYTES):
                    said += got
        return Pulse(said.count(BEAT), READY in said)

    def close(self) -> None:
        """Cut it."""
        self.passed()
        if self._read >= 0:
            os.close(self._read)
            self._read = -1
