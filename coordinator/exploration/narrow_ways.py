"""Ways that are hardly wider than a robot: where there are such, and which of them were tried and are too narrow.

A team's map is too coarse to tell a gap that a robot just fits through from one that is a little narrower. Robots are
sent to try, when there is nothing else for them; where one has measured that it does not fit, no other is sent twice.
"""

import math
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from robrain.protocol.model.clearance import mapped_clearance_m
from robrain.protocol.model.geometry import Point2D

if TYPE_CHECKING:  # brings the map's kernels, which a coordinator loads when it is up (coordinator/live.py)
    from robrain.protocol.model.navigation import NavigationGrid
    from robrain.protocol.model.occupancy_grid import OccupancyGrid

SHUT_RADIUS_M = 0.6
"""Narrow places within this of where a robot stood that did not fit are taken to be what it did not fit through."""
TRIES = 2
"""So many robots, or times, find a way too narrow or do not get through until it is given up."""
KEPT = 256


class Gap(NamedTuple):
    """A gap that a robot did not fit through."""

    place: Point2D
    """Where the robot stood before it, arena frame."""
    gap_m: float
    tries: int
    again_ns: int
    """When it may be tried again, if it may."""


class NarrowWays:
    """Remembers what was tried, and keeps the map with narrow places for as long as it is needed."""

    def __init__(self) -> None:
        self.gaps: deque[Gap] = deque(maxlen=KEPT)
        self._failures: deque[tuple[Point2D, int]] = deque(maxlen=KEPT)
        self._navigation: NavigationGrid | None = None
        self._version = 0

    def note_gap(self, place: Point2D, gap_m: float, again_ns: int) -> None:
        """A robot stood at a place before a gap that it does not fit through."""
        tries = 0
        for known in list(self.gaps):
            if _apart_m(known.place, place) < SHUT_RADIUS_M:
                self.gaps.remove(known)
                tries = max(tries, known.tries)
        self.gaps.append(Gap(place, gap_m, tries + 1, again_ns))

    def note_failure(self, goal: Point2D) -> None:
        """A robot that was sent by a narrow way did not get there, for whatever reason."""
        tries = 0
        for known in list(self._failures):
            if _apart_m(known[0], goal) < SHUT_RADIUS_M:
                self._failures.remove(known)
                tries = max(tries, known[1])
        self._failures.append((goal, tries + 1))

    def is_given_up(self, goal: Point2D) -> bool:
        """Whether robots have failed to get to a place by narrow ways as often as they are to."""
        return any(tries >= TRIES and _apart_m(place, goal) < SHUT_RADIUS_M for place, tries in self._failures)

    def shut(self, now_ns: int) -> list[tuple[float, float, float]]:
        """Circles (x, y, radius in metres, arena frame) whose narrow places no robot is to be sent through now."""
        return [
            (gap.place.x_m, gap.place.y_m, SHUT_RADIUS_M)
            for gap in self.gaps
            if gap.tries >= TRIES or now_ns < gap.again_ns
        ]

    def look(self, grid: "OccupancyGrid", radius_m: float, preferred_m: float) -> "NavigationGrid":
        """The map as it is for robots of this radius, narrow places included."""
        from robrain.protocol.model.navigation import NavigationGrid

        needed_m = min(preferred_m, mapped_clearance_m(radius_m, grid.geometry.resolution_m))
        known = self._navigation
        if known is None or (known.needed_m, known.preferred_m) != (needed_m, preferred_m):
            known = NavigationGrid(grid.classes(), grid.geometry, needed_m, preferred_m=preferred_m)
        elif self._version != grid.version:
            known.update(grid.classes())
        self._navigation, self._version = known, grid.version
        return known


def _apart_m(one: Point2D, other: Point2D) -> float:
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m)
