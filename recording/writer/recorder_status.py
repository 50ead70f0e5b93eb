"""What a recorder says of itself on the wire and in the log: each second in live, and when something is wrong."""

import logging
import threading
import time
from collections.abc import Callable

import msgspec

from robrain.protocol.wire.clock import Clock, to_ns, to_seconds
from robrain.protocol.wire.messages.team.recorder_messages import RecorderState
from robrain.protocol.wire.publisher import Publisher

logger = logging.getLogger(__name__)

STATE_NS = to_ns(1.0)
"""How often a live recorder tells how it does."""
SLOW_S = 1.0
"""A step that takes longer than this is reported."""
SLOW = "as the disk or the machine is too slow"


class RecorderTelling:
    """Says how a recorder does.

    A disk that hangs is told while it hangs in live, from a thread of its own; in lockstep, where the run waits for the
    disk, afterwards.

    Args:
        states: where it is said.
        clock: the recorder's.
        look: tells how the recorder is just now, from any thread.
        live: whether others go on while the recorder waits.
    """

    def __init__(self, states: Publisher, clock: Clock, look: Callable[[], RecorderState], *, live: bool) -> None:
        self._states = states
        self._clock = clock
        self._look = look
        self._live = live
        self._lock = threading.Lock()
        self._lost_told = 0
        self._said_ns: int | None = None
        self._began_ns = 0
        self._watch = DiskWatch(self._hangs, SLOW_S) if live else None

    def begin(self) -> None:
        """The recorder begins to write."""
        self._began_ns = self._clock.now_ns()
        if self._watch is not None:
            self._watch.begin()

    def end(self, lost: int) -> None:
        """It has written, and so many messages are lost in all."""
        if self._watch is not None:
            self._watch.end()
        now_ns = self._clock.now_ns()
        took_s = to_seconds(now_ns - self._began_ns)
        slow = took_s > SLOW_S
        due = self._said_ns is None or not 0 <= now_ns - self._said_ns < STATE_NS
        if slow:
            logger.warning("recording is slow: writing took %.1f s, %s", took_s, SLOW)
        if (due and (self._live or lost > self._lost_told)) or slow:
            self._said_ns = now_ns
            self._lost_told = lost
            self._say(f"writing took {took_s:.1f} s, {SLOW}" if slow else "")

    def close(self) -> None:
        """Say the last."""
        if self._watch is not None:
            self._watch.close()
        self._say("")

    def _hangs(self, lasted_s: float) -> None:
        if lasted_s < 2 * SLOW_S:  # once in the log, again and again on the wire
            logger.warning("recording has written nothing for %.1f s, %s", lasted_s, SLOW)
        self._say(f"nothing has been written for {lasted_s:.1f} s, {SLOW}")

    def _say(self, why: str) -> None:
        with self._lock:
            state = self._look()
            self._states.put(msgspec.structs.replace(state, why="; ".join(filter(None, (state.why, why)))))


class DiskWatch:
    """Calls `tell` with the seconds that a step has lasted, once each `period_s` while it lasts longer than that.

    Args:
        tell: called on the watch's own thread.
        period_s: how long a step may last before it is told.
    """

    def __init__(self, tell: Callable[[float], None], period_s: float) -> None:
        self._tell = tell
        self._period_s = period_s
        self._began_s: float | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="disk-watch", daemon=True)
        self._thread.start()

    def begin(self) -> None:
        """A step begins."""
        self._began_s = time.monotonic()

    def end(self) -> None:
        """The step is over."""
        self._began_s = None

    def close(self) -> None:
        """Stop watching; calling it again does nothing."""
        self._ended.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._ended.wait(self._period_s):
            began_s = self._began_s
            lasted_s = 0.0 if began_s is None else time.monotonic() - began_s
            if lasted_s > self._period_s:
                self._tell(lasted_s)
