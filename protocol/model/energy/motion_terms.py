"""Integrals of the factors of a robot's power, kept long enough to be asked for between two stamps of its battery."""

from bisect import bisect_right
from collections import deque

from robrain.protocol.model.energy.energy_model import STANDING_BELOW

KEPT = 128
"""Samples that are kept: 25 s at 5 Hz."""
GAP_S = 0.5
"""A longer time without a sample is a hole."""
NS = 1e-9

Amounts = tuple[float, float, float, float, float]


class MotionTerms:
    """Adds up motion, sample by sample. Between samples the speeds are taken to change evenly."""

    def __init__(self) -> None:
        self._stamps: deque[int] = deque(maxlen=KEPT)
        self._sums: deque[Amounts] = deque(maxlen=KEPT)
        self._speed_m_s = 0.0
        self._yaw_rate_rad_s = 0.0

    def move(self, stamp_ns: int, speed_m_s: float, yaw_rate_rad_s: float) -> float:
        """Take in the absolute speeds at a time; returns the time since the sample before, 0 for the first."""
        before_m_s, before_rad_s = self._speed_m_s, self._yaw_rate_rad_s
        self._speed_m_s, self._yaw_rate_rad_s = speed_m_s, yaw_rate_rad_s
        if self._stamps and stamp_ns - self._stamps[-1] > GAP_S / NS:
            self._stamps.clear()
            self._sums.clear()
        if not self._stamps:
            self._stamps.append(stamp_ns)
            self._sums.append((0.0, 0.0, 0.0, 0.0, 0.0))
            return 0.0
        elapsed_s = (stamp_ns - self._stamps[-1]) * NS
        if elapsed_s <= 0:
            return 0.0
        duration_s, moving_s, path_m, turned_rad, started = self._sums[-1]
        mean_m_s, mean_rad_s = 0.5 * (before_m_s + speed_m_s), 0.5 * (before_rad_s + yaw_rate_rad_s)
        is_moving = mean_m_s > STANDING_BELOW or mean_rad_s > STANDING_BELOW
        gained = 0.5 * (speed_m_s * speed_m_s - before_m_s * before_m_s)
        self._stamps.append(stamp_ns)
        self._sums.append(
            (
                duration_s + elapsed_s,
                moving_s + (elapsed_s if is_moving else 0.0),
                path_m + mean_m_s * elapsed_s,
                turned_rad + mean_rad_s * elapsed_s,
                started + max(0.0, gained),
            )
        )
        return elapsed_s

    def between(self, from_ns: int, to_ns: int) -> Amounts | None:
        """The integrals between two stamps, in the order of `TERMS`; None if they are not known, or empty."""
        begun, ended = self._at(from_ns), self._at(to_ns)
        if begun is None or ended is None or to_ns <= from_ns:
            return None
        duration_s, moving_s, path_m, turned_rad, started = (b - a for a, b in zip(begun, ended, strict=True))
        return duration_s, moving_s, path_m, turned_rad, started

    def _at(self, stamp_ns: int) -> Amounts | None:
        if not self._stamps or not self._stamps[0] <= stamp_ns <= self._stamps[-1]:
            return None
        upper = min(len(self._stamps) - 1, max(1, bisect_right(self._stamps, stamp_ns)))
        first_ns, last_ns = self._stamps[upper - 1], self._stamps[upper]
        share = (stamp_ns - first_ns) / max(last_ns - first_ns, 1)
        lower, higher = self._sums[upper - 1], self._sums[upper]
        duration_s, moving_s, path_m, turned_rad, started = (
            a + share * (b - a) for a, b in zip(lower, higher, strict=True)
        )
        return duration_s, moving_s, path_m, turned_rad, started
