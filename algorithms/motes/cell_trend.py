"""When a mote's cells will be empty, by the fall of their voltage."""

import math
from collections import deque

from robrain.algorithms.motes.mote_energy import FLAT_V

LEAST_FALL_V = 0.01
"""A fall that a mote's millivolts tell well enough (chosen)."""
KEPT = 32


class CellTrend:
    """Voltages of one mote, the last that differed.

    >>> trend = CellTrend()
    >>> for at_s, voltage_v in ((0.0, 2.5), (100.0, 2.4), (200.0, 2.3)):
    ...     trend.note(at_s, voltage_v)
    >>> round(trend.empty_s() or 0.0)
    400
    """

    def __init__(self) -> None:
        self._falls: deque[tuple[float, float]] = deque(maxlen=KEPT)

    def note(self, at_s: float, voltage_v: float) -> None:
        """A voltage was told; fresh cells begin a new trend."""
        if self._falls and voltage_v > self._falls[-1][1] + LEAST_FALL_V:
            self._falls.clear()
        if not self._falls or voltage_v < self._falls[-1][1]:
            self._falls.append((at_s, voltage_v))

    def empty_s(self) -> float | None:
        """Time at which the cells are flat if they go on like this; None if they have not fallen enough to tell."""
        if len(self._falls) < 2:
            return None
        (first_s, first_v), (last_s, last_v) = self._falls[0], self._falls[-1]
        if first_v - last_v < LEAST_FALL_V or last_s <= first_s:
            return None
        left_s = max(0.0, last_v - FLAT_V) * (last_s - first_s) / (first_v - last_v)
        return last_s + left_s if math.isfinite(left_s) else None
