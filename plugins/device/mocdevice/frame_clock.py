"""Time of measurement of encoder frames: from their stamps, or from their counter if stamps are those of arrival.

The controller sends a frame every 20 ms and counts them. Frames delayed by an adapter or a busy computer arrive in
bursts; by stamps of arrival all the motion would happen at once. The counter gives the time of each frame on the
controller's clock. The offset from that clock to the robot's is the minimum of the recently observed offsets, because
delays only increase it. The skew is neglected, because windows are short. Source: Moon, Skelly, Towsley, Estimation and
removal of clock skew from network delay measurements, 1999.
"""

from enum import StrEnum

from robrain.protocol.can.payload import LONGEST_GAP, MODULUS
from robrain.protocol.clock import NS_PER_S

OTHER_CLOCK_NS = NS_PER_S
"""A first stamp that differs more from the robot's time is by another clock."""
WINDOW = 256
"""Messages of a window; of the controller's frames 5 s."""
RESTART_FRAMES = MODULUS // 2
"""Delay, in frames, after which the clock starts again, because the 8-bit counter may have wrapped."""


class StampedAt(StrEnum):
    """Meaning of the time stamps of an interface's frames."""

    SENDING = "sending"
    """Time at which the controller sent the frame, by the robot's clock."""
    ARRIVAL = "arrival"
    """Time at which the robot's computer received the frame."""


class LeastDelay:
    """The least of the recent delays: that of the current window of messages and the one before it."""

    def __init__(self) -> None:
        self.ns = 0
        self._count = self._least_ns = self._before_ns = 0

    def restart(self, delay_ns: int) -> None:
        """Forget the earlier delays; this one is the first."""
        self._count, self.ns = 0, delay_ns
        self._least_ns = self._before_ns = delay_ns

    def observe(self, delay_ns: int) -> int:
        """Add the delay of the next message; returns the least."""
        if self._count == WINDOW:
            self._count, self._before_ns, self._least_ns = 0, self._least_ns, delay_ns
        self._count += 1
        self._least_ns = min(self._least_ns, delay_ns)
        self.ns = min(self._least_ns, self._before_ns)
        return self.ns


class FrameClock:
    """Gives each frame of one controller its *frame time*: the robot's time less an offset.

    The offset changes when a frame arrives with less delay than all recent ones.

    Args:
        stamped_at: meaning of the stamps.
        period_ns: period at which the controller sends frames.

    """

    def __init__(self, stamped_at: StampedAt, period_ns: int) -> None:
        self.offset_ns = 0
        """Current estimate of the robot's time less frame time."""
        self._counts = stamped_at is StampedAt.ARRIVAL
        self._period_ns = period_ns
        self._restart_ns = RESTART_FRAMES * period_ns
        self._has_stamps = False
        self._counter: int | None = None
        self._frame_ns = self._stamp_ns = 0
        self._delay = LeastDelay()

    def add(self, counter: int | None, stamp_ns: int, now_ns: int) -> int:
        """Take the next frame; returns its time of measurement in frame time.

        Args:
            counter: the frame's 8-bit counter; None if it has none, and its stamp is its time.
            stamp_ns: its stamp by the interface.
            now_ns: the robot's time now.

        """
        # A stamp after one by the robot's clock is by that clock too, however old it is: the frame was late.
        if not (self._has_stamps and self._stamp_ns <= stamp_ns <= now_ns):
            self._has_stamps = abs(now_ns - stamp_ns) <= OTHER_CLOCK_NS
            stamp_ns = stamp_ns if self._has_stamps else now_ns
        self._stamp_ns = stamp_ns
        if not self._counts or counter is None:
            self._frame_ns = stamp_ns
            return stamp_ns
        before, self._counter = self._counter, counter
        step = (counter - before) % MODULUS if before is not None else MODULUS
        frame_ns = self._frame_ns + step * self._period_ns
        if step > LONGEST_GAP or stamp_ns - frame_ns - self.offset_ns > self._restart_ns:
            frame_ns = max(stamp_ns - self.offset_ns, self._frame_ns)
            self._delay.restart(stamp_ns - frame_ns)
        self._frame_ns = frame_ns
        self.offset_ns = self._delay.observe(stamp_ns - frame_ns)
        return frame_ns

    def restart_stamp(self) -> None:
        """Use the next frame's stamp as its time of measurement: the controller has restarted."""
        self._counter = None
