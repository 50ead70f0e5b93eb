"""The way of velocities to the robot, which says zero once nothing else is commanded.

A velocity holds for `HOLD_S`; then zero is published, `ZEROS` times, in case one is lost. While the robot is halted,
zero is published all the time, so that no other node drives it. This is done on the thread of the ROS node: it also
stops a robot whose plugin hangs. A robot whose agent has died stops by its own watchdog.
"""

from collections.abc import Callable
from threading import Lock

from robrain.protocol.clock import to_ns
from robrain.protocol.model.geometry import Twist2D

HOLD_NS = to_ns(0.2)
ZEROS = 10
TICK_S = 0.05
"""Period of `tick`."""
STANDING = Twist2D()


class CommandGate:
    """Publishes velocities, and zero when they lapse; it may be used from any thread.

    Args:
        publish: publishes a velocity, body frame; it must not wait.
        now_ns: a clock that is never set.

    """

    def __init__(self, publish: Callable[[Twist2D], None], now_ns: Callable[[], int]) -> None:
        self._publish, self._now_ns = publish, now_ns
        self._lock = Lock()
        self._lapses_ns: int | None = None
        """When the last command lapses; None while the robot is to stand."""
        self._zeros = 0
        self._held_ns: int | None = None
        self._is_closed = False

    def drive(self, twist: Twist2D) -> None:
        """Command a velocity for `HOLD_S`; without effect while the gate is held, and after its end."""
        with self._lock:
            if self._held_ns is None and not self._is_closed:
                self._lapses_ns = self._now_ns() + HOLD_NS
                self._publish(twist)

    def stop(self) -> None:
        """Command zero, now and some times more."""
        with self._lock:
            self._stand()

    def hold(self) -> None:
        """Command zero until `release`, whatever else is commanded."""
        with self._lock:
            self._held_ns = self._now_ns()
            self._stand()

    def release(self) -> None:
        """End `hold`, for a step of the plugin, which has none while it is halted.

        Without effect just after `hold`: that step may have begun before the halt.
        """
        with self._lock:
            if self._held_ns is not None and self._now_ns() - self._held_ns >= HOLD_NS:
                self._held_ns = None

    def tick(self) -> None:
        """Say zero if that is due; called every `TICK_S`."""
        with self._lock:
            if self._is_closed:
                return
            if self._lapses_ns is not None and self._now_ns() >= self._lapses_ns:
                self._stand()
            elif self._held_ns is not None or self._zeros:
                self._zeros = max(self._zeros - 1, 0)
                self._publish(STANDING)

    def close(self) -> None:
        """Command zero once more, and nothing from then on."""
        with self._lock:
            if not self._is_closed:
                self._stand()
                self._is_closed = True

    def _stand(self) -> None:
        if self._is_closed:
            return
        self._lapses_ns, self._zeros = None, ZEROS
        self._publish(STANDING)
