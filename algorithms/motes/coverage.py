"""Which motes are on duty so that the floor stays covered: as few as possible, in turn, the full ones first."""

import math
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from functools import reduce
from operator import or_

from robrain.algorithms.motes.mote_energy import FLAT_V
from robrain.protocol.model.geometry import Point2D

Spots = int
"""A set of sample points of the floor, a bit each."""


class CoverageMap:
    """Which sample points of the floor each mote covers.

    Args:
        places: of the motes, arena frame.
        points: sample points of the floor, arena frame.
        radius_m: a mote senses the floor up to this distance.

    """

    def __init__(self, places: Sequence[Point2D], points: Sequence[Point2D], radius_m: float) -> None:
        self.points = len(points)
        self.covered: list[Spots] = [
            sum(1 << index for index, point in enumerate(points) if point.distance_m(place) <= radius_m)
            for place in places
        ]
        """Of each mote."""

    def share(self, motes: Collection[int]) -> float:
        """Share of the sample points that some of these motes cover."""
        return self.spots(motes).bit_count() / self.points

    def spots(self, motes: Collection[int]) -> Spots:
        """Sample points that these motes cover."""
        return reduce(or_, (self.covered[mote] for mote in motes), 0)


def duty_set(cover: CoverageMap, left: Mapping[int, float]) -> list[int]:
    """A small set of motes that covers all that the living ones cover, preferably with much remaining energy.

    This is the greedy set cover (Chvátal, Mathematics of Operations Research 4(3), 1979). Each mote's gain is
    multiplied by its remaining share of energy. Motes that prove unnecessary are then removed, emptiest first. Repeated
    from time to time with the present energies, the motes take turns.

    Args:
        cover: the points that each mote covers.
        left: remaining share of energy of each living mote, above 0.

    """
    wanted = cover.spots(left)
    chosen: list[int] = []
    open_spots = wanted
    while open_spots:
        best = max(left, key=lambda mote: ((cover.covered[mote] & open_spots).bit_count() * left[mote], -mote))
        chosen.append(best)
        open_spots &= ~cover.covered[best]
    for mote in sorted(chosen, key=lambda mote: (left[mote], mote)):
        others = [other for other in chosen if other != mote]
        if cover.spots(others) == wanted:
            chosen = others
    return sorted(chosen)


LEAST_FALL_V = 0.01
"""A fall that a mote's millivolts show well enough (chosen)."""
KEPT = 32


class CellTrend:
    """Voltages of one mote, the last that differed.

    >>> trend = CellTrend()
    >>> for at_s, voltage_v in ((0.0, 2.5), (100.0, 2.4), (200.0, 2.3)):
    ...     trend.add(at_s, voltage_v)
    >>> round(trend.empty_s() or 0.0)
    400
    """

    def __init__(self) -> None:
        self._falls: deque[tuple[float, float]] = deque(maxlen=KEPT)

    def add(self, at_s: float, voltage_v: float) -> None:
        """Add a reported voltage; fresh cells begin a new trend."""
        if self._falls and voltage_v > self._falls[-1][1] + LEAST_FALL_V:
            self._falls.clear()
        if not self._falls or voltage_v < self._falls[-1][1]:
            self._falls.append((at_s, voltage_v))

    def empty_s(self) -> float | None:
        """Time at which the cells are flat on the present trend; None if they have not fallen enough."""
        if len(self._falls) < 2:
            return None
        (first_s, first_v), (last_s, last_v) = self._falls[0], self._falls[-1]
        if first_v - last_v < LEAST_FALL_V or last_s <= first_s:
            return None
        left_s = max(0.0, last_v - FLAT_V) * (last_s - first_s) / (first_v - last_v)
        return last_s + left_s if math.isfinite(left_s) else None
