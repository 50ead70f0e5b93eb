"""Odometry: from counts of wheels to displacements and a track of poses, with the turning of a gyroscope."""

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Iterable
from operator import itemgetter
from typing import NamedTuple

from robrain.protocol.model.geometry import Pose2D, Twist2D, wrap_angle_rad


class PoseTrack:
    """The last poses of something that moves.

    Args:
        pose: before the first entry.
        entries_max: number of poses kept.
        entries: time (ns) and pose, the oldest first.

    """

    def __init__(self, pose: Pose2D, entries_max: int, entries: Iterable[tuple[int, Pose2D]] = ()) -> None:
        self.pose = pose
        """The newest one."""
        self._history: deque[tuple[int, Pose2D]] = deque(entries, entries_max)
        if self._history:
            self.pose = self._history[-1][1]

    @property
    def until_ns(self) -> int | None:
        """Time of the newest pose; None before the first."""
        return self._history[-1][0] if self._history else None

    def add(self, stamp_ns: int, pose: Pose2D) -> None:
        """Add the next pose; times do not descend."""
        self.pose = pose
        self._history.append((stamp_ns, pose))

    def pose_at(self, stamp_ns: int) -> Pose2D:
        """The pose at a time, between the entries before and after it.

        Before the first entry kept it is that entry's pose, after `until_ns` the newest one.
        """
        history = self._history
        if not history or stamp_ns >= history[-1][0]:
            return self.pose
        index = bisect_left(history, stamp_ns, key=itemgetter(0))
        after_ns, after = history[index]
        if index == 0 or after_ns == stamp_ns:
            return after
        before_ns, before = history[index - 1]
        share = (stamp_ns - before_ns) / (after_ns - before_ns)
        return Pose2D(
            before.x_m + share * (after.x_m - before.x_m),
            before.y_m + share * (after.y_m - before.y_m),
            wrap_angle_rad(before.yaw_rad + share * wrap_angle_rad(after.yaw_rad - before.yaw_rad)),
        )


GAP_NS = 300_000_000
"""A longer time between two measurements is not added up."""
FRAMES_KEPT = 64
"""Frames of the wheels, so that measurements may arrive later than these: 1.3 s at the usual period."""
STILL_AFTER_NS = 200_000_000
"""Time for which the robot may still rock after its wheels have stopped."""
WINDOW_NS = 500_000_000
SPREAD_RAD_S = 0.05
"""Largest spread of the measurements of a window while the robot stands."""
STILL_RAD_S = 0.02
"""Slower turning while the wheels stand counts as a change of the bias; a person who turns the robot is faster."""
BIAS_MAX_RAD_S = 0.2
"""Largest plausible bias."""
ELSEWHERE_WINDOWS = 10
"""Number of consecutive windows with another steady value that mean another bias, not a turn."""
WINDOWS_MAX = 60
"""The bias is the mean of at least this many recent windows, once there have been as many."""
COMPARED_RAD = 0.4
"""The two are compared each time that the wheels have turned the robot by this angle in `COMPARED_NS`."""
COMPARED_NS = 10_000_000_000
"""A longer time is skipped: wheels of unequal sizes seem to turn the robot slowly while it drives ahead."""
RATIO_MIN, RATIO_MAX = -0.3, 4.0
"""Of the gyroscope's turning to the wheels'. Blocked wheels give 0, a track configured at 3 times its size gives 3."""
REFUSED_AFTER, TRUSTED_AFTER = 2, 3
"""Numbers of consecutive comparisons that decide; a single one may be a person who pushes the robot."""


class YawRate(NamedTuple):
    """One measurement of a gyroscope."""

    stamp_ns: int
    """Time of measurement, robot's clock."""
    rad_s: float
    """About the robot's vertical axis, to the left positive, with its bias."""


class _Wheels(NamedTuple):
    stamp_ns: int
    turned_rad: float
    """Sum of the wheels' turning until then."""


class _Compared:
    """Turning since the last comparison."""

    def __init__(self) -> None:
        self.turned_rad = self.by_wheels_rad = 0.0
        self.elapsed_ns = 0


class GyroYaw:
    """Finds how far the robot has turned beyond the turn by its wheels."""

    def __init__(self) -> None:
        self.bias_rad_s: float | None = None
        """None before the robot has stood for half a second."""
        self.is_used = False
        """Whether `follow` has had a measurement."""
        self.rate_rad_s: float | None = None
        """Rate without the bias by the last measurement; None while there is none, or the bias is not known."""
        self.is_trusted = True
        """Whether its turning counts; False while it contradicts the wheels."""
        self.ratio = 1.0
        """Its turning as a multiple of the wheels', by the last comparison."""
        self.comparisons = 0
        """So far."""
        self._compared = _Compared()
        self._in_a_row = 0
        """Comparisons in a row that speak against `is_trusted`."""
        self._wheels: deque[_Wheels] = deque(maxlen=FRAMES_KEPT)
        self._turned_rad = 0.0
        self._moved_ns = 0
        self._last: YawRate | None = None
        self._last_wheels_rad: float | None = None
        self._windows = self._elsewhere = 0
        self._window: list[float] = []
        self._window_ns = 0

    def follow(self, rates: deque[YawRate], turned_rad: float, stamp_ns: int, *, is_moving: bool) -> float:
        """Take a frame of the wheels, and the measurements until its time; returns the angle to add to the yaw.

        Args:
            rates: measurements in order; those that are used are taken out.
            turned_rad: by the wheels, since the frame before.
            stamp_ns: time of the frame, robot's clock.
            is_moving: whether any wheel has turned since the frame before.

        """
        if self._wheels and stamp_ns <= self._wheels[-1].stamp_ns:  # a clock was set back: times before mean nothing
            self._wheels.clear()
            rates.clear()
            self._last = self._last_wheels_rad = None
        self._turned_rad += turned_rad
        self._wheels.append(_Wheels(stamp_ns, self._turned_rad))
        if is_moving:
            self._moved_ns = stamp_ns
        beyond_rad = 0.0
        while rates and rates[0].stamp_ns <= stamp_ns:
            self.is_used = True
            beyond_rad += self._handle(rates.popleft())
        if self._last is None or stamp_ns - self._last.stamp_ns > GAP_NS:
            self.rate_rad_s = None
        return beyond_rad

    @property
    def agrees(self) -> bool:
        """Whether the last comparison was one that wheels may have."""
        return RATIO_MIN <= self.ratio <= RATIO_MAX

    def _handle(self, rate: YawRate) -> float:
        last, self._last = self._last, rate
        wheels_rad, self._last_wheels_rad = self._last_wheels_rad, self._wheels_at(rate.stamp_ns)
        bias_rad_s = self.bias_rad_s
        self.rate_rad_s = rate.rad_s - bias_rad_s if bias_rad_s is not None and self.is_trusted else None
        elapsed_ns = 0 if last is None else rate.stamp_ns - last.stamp_ns
        if last is None or not 0 < elapsed_ns <= GAP_NS:
            self._forget_window()
            return 0.0
        is_still = last.stamp_ns - self._moved_ns >= STILL_AFTER_NS
        if is_still:
            self._learn(rate.rad_s, elapsed_ns)
        else:
            self._forget_window()
        if bias_rad_s is None or wheels_rad is None or self._last_wheels_rad is None:
            return 0.0
        if is_still and abs(rate.rad_s - bias_rad_s) <= STILL_RAD_S:
            self.rate_rad_s = 0.0 if self.is_trusted else None
            return 0.0
        turned_rad = ((last.rad_s + rate.rad_s) / 2 - bias_rad_s) * elapsed_ns * 1e-9
        by_wheels_rad = self._last_wheels_rad - wheels_rad
        self._compare(turned_rad, by_wheels_rad, elapsed_ns)
        return turned_rad - by_wheels_rad if self.is_trusted else 0.0

    def _compare(self, turned_rad: float, by_wheels_rad: float, elapsed_ns: int) -> None:
        """Compare the gyroscope with the wheels.

        A wrong yaw added before is not withdrawn: dead reckoning must not jump (REP 105), and localisation corrects the
        error.
        """
        compared = self._compared
        compared.turned_rad += turned_rad
        compared.by_wheels_rad += by_wheels_rad
        compared.elapsed_ns += elapsed_ns
        if abs(compared.by_wheels_rad) < COMPARED_RAD:
            if compared.elapsed_ns > COMPARED_NS:
                self._compared = _Compared()
            return
        self._compared = _Compared()
        self.comparisons += 1
        self.ratio = compared.turned_rad / compared.by_wheels_rad
        agrees = self.agrees
        self._in_a_row = self._in_a_row + 1 if agrees is not self.is_trusted else 0
        if self._in_a_row >= (REFUSED_AFTER if self.is_trusted else TRUSTED_AFTER):
            self.is_trusted, self._in_a_row = agrees, 0

    def _wheels_at(self, stamp_ns: int) -> float | None:
        """Sum of the wheels' turning at a time; None before the frames that are kept."""
        after = self._wheels[-1]
        for frame in reversed(self._wheels):
            if frame.stamp_ns <= stamp_ns:
                if after.stamp_ns <= stamp_ns:
                    return after.turned_rad
                share = (stamp_ns - frame.stamp_ns) / (after.stamp_ns - frame.stamp_ns)
                return frame.turned_rad + share * (after.turned_rad - frame.turned_rad)
            after = frame
        return None

    def _learn(self, rad_s: float, elapsed_ns: int) -> None:
        self._window.append(rad_s)
        self._window_ns += elapsed_ns
        if self._window_ns < WINDOW_NS:
            return
        window = self._window
        mean_rad_s, spread_rad_s = sum(window) / len(window), max(window) - min(window)
        self._forget_window()
        if spread_rad_s > SPREAD_RAD_S or abs(mean_rad_s) > BIAS_MAX_RAD_S:
            self._elsewhere = 0
            return
        if self.bias_rad_s is not None and abs(mean_rad_s - self.bias_rad_s) > STILL_RAD_S:
            self._elsewhere += 1
            if self._elsewhere < ELSEWHERE_WINDOWS:
                return
            self._windows = 0
        self._elsewhere = 0
        self._windows = min(self._windows + 1, WINDOWS_MAX)
        before_rad_s = 0.0 if self._windows == 1 or self.bias_rad_s is None else self.bias_rad_s
        self.bias_rad_s = before_rad_s + (mean_rad_s - before_rad_s) / self._windows

    def _forget_window(self) -> None:
        self._window, self._window_ns = [], 0


def moved(pose: Pose2D, displacement: Twist2D) -> Pose2D:
    """A pose after a small displacement in its own frame (a twist times the time it lasted: m, m, rad).

    It is exact for constant velocity over the step: the exponential map of SE(2). Source: Solà, Deray, Atchuthan, A
    micro Lie theory for state estimation in robotics, 2018, equations 156 and 158.
    """
    forward, left, turn = displacement.forward_m_s, displacement.left_m_s, displacement.yaw_rad_s
    if abs(turn) < 1e-9:
        sine, cosine = 1.0, turn / 2
    else:
        sine, cosine = math.sin(turn) / turn, 2 * math.sin(turn / 2) ** 2 / turn
    dx, dy = sine * forward - cosine * left, cosine * forward + sine * left
    cos, sin = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    yaw_rad = pose.yaw_rad + turn
    return Pose2D(
        pose.x_m + cos * dx - sin * dy,
        pose.y_m + sin * dx + cos * dy,
        yaw_rad if -math.pi < yaw_rad <= math.pi else wrap_angle_rad(yaw_rad),
    )


def chord(before: Pose2D, after: Pose2D) -> Twist2D:
    """The displacement (m, m, rad) between two poses, its path in the frame that faces halfway between their yaws."""
    dx, dy = after.x_m - before.x_m, after.y_m - before.y_m
    turn = wrap_angle_rad(after.yaw_rad - before.yaw_rad)
    cos, sin = math.cos(before.yaw_rad + turn / 2), math.sin(before.yaw_rad + turn / 2)
    return Twist2D(cos * dx + sin * dy, cos * dy - sin * dx, turn)


def moved_along(pose: Pose2D, displacement: Twist2D) -> Pose2D:
    """A pose after a displacement as `chord` gives it."""
    forward, left, turn = displacement.forward_m_s, displacement.left_m_s, displacement.yaw_rad_s
    cos, sin = math.cos(pose.yaw_rad + turn / 2), math.sin(pose.yaw_rad + turn / 2)
    return Pose2D(
        pose.x_m + cos * forward - sin * left,
        pose.y_m + sin * forward + cos * left,
        wrap_angle_rad(pose.yaw_rad + turn),
    )
