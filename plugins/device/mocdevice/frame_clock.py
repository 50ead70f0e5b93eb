"""When encoder frames were measured: by their stamps, or by their counter where stamps tell only when they arrived.

The controller sends a frame every 20 ms and counts them. Frames that were held up on the way, by an adapter or a busy
computer, arrive late and in bursts; stamps of their arrival would say that all the motion happened at once. The
counter gives each frame's time on the controller's own clock. The offset between that clock and the robot's is the
least that has been observed lately: delays only ever add to it (Moon, Skelly, Towsley: Estimation and removal of clock
skew from network delay measurements, 1999, without the skew, which two short windows in turn make unnecessary).
"""

from enum import StrEnum

from robrain.protocol.can.sequence import LONGEST_GAP, MODULUS
from robrain.protocol.wire.clock import NS_PER_S, to_ns

FRAME_PERIOD_NS = to_ns(0.02)
OTHER_CLOCK_NS = NS_PER_S
"""A first stamp that is farther from now than this is of another clock."""
WINDOW_FRAMES = 256
"""The least offset is that of the current window of so many frames and the one before: 5 to 10 s."""
ANEW_NS = to_ns(128 * 0.02)
"""After a frame that is so much later than its counter says, nobody knows how often the counter has turned over."""


class StampedAt(StrEnum):
    """What the time stamps of an interface's frames stand for."""

    SENDING = "sending"
    """The sender's time, by the robot's clock: however late a frame is, it tells when it was measured."""
    ARRIVAL = "arrival"
    """The time at which the robot's computer got the frame."""


class FrameClock:
    """Keeps the frames of one controller on one axis of time, *frame time*, and relates that to the robot's clock.

    Frame time is the robot's time less an offset, which changes when a frame shows that others were later than assumed.

    Args:
        stamped_at: what stamps stand for.

    """

    def __init__(self, stamped_at: StampedAt) -> None:
        self.offset_ns = 0
        """The robot's time less frame time, as far as is known now."""
        self._counts = stamped_at is StampedAt.ARRIVAL
        self._knows_stamps = False
        self._counter: int | None = None
        self._frame_ns = self._stamp_ns = 0
        self._frames = 0
        self._least_ns = self._least_before_ns = 0

    def note(self, counter: int, stamp_ns: int, now_ns: int) -> int:
        """Take the next frame; when it was measured, in frame time.

        Args:
            counter: the frame's 8-bit counter.
            stamp_ns: the stamp that the interface gave it.
            now_ns: the robot's time at which it is read.

        """
        # A stamp that follows one of the robot's clock may be as old as it likes: the frame was late.
        if not (self._knows_stamps and self._stamp_ns <= stamp_ns <= now_ns):
            self._knows_stamps = abs(now_ns - stamp_ns) <= OTHER_CLOCK_NS
            stamp_ns = stamp_ns if self._knows_stamps else now_ns
        self._stamp_ns = stamp_ns
        if not self._counts:
            self._frame_ns = stamp_ns
            return stamp_ns
        before, self._counter = self._counter, counter
        step = (counter - before) % MODULUS if before is not None else MODULUS
        frame_ns = self._frame_ns + step * FRAME_PERIOD_NS
        if step > LONGEST_GAP or stamp_ns - frame_ns - self.offset_ns > ANEW_NS:
            frame_ns = max(stamp_ns - self.offset_ns, self._frame_ns)
            self._frames = 0
            self._least_ns = self._least_before_ns = stamp_ns - frame_ns
        self._frame_ns = frame_ns
        self._observe(stamp_ns - frame_ns)
        return frame_ns

    def start_anew(self) -> None:
        """Take the next frame's stamp for the time it was measured: the controller has started anew."""
        self._counter = None

    def _observe(self, offset_ns: int) -> None:
        if self._frames == WINDOW_FRAMES:
            self._frames = 0
            self._least_before_ns, self._least_ns = self._least_ns, offset_ns
        self._frames += 1
        self._least_ns = min(self._least_ns, offset_ns)
        self.offset_ns = min(self._least_ns, self._least_before_ns)
