"""Gaps that robots did not fit through. Imports no kernels: a coordinator loads them once it is up."""

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from robrain.algorithms.navigation.clearance import mapped_clearance_m
from robrain.protocol.model.geometry import Point2D

if TYPE_CHECKING:
    from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
    from robrain.algorithms.navigation.navigation_grid import NavigationGrid

SHUT_RADIUS_M = 0.6
"""Narrow places within this distance of a robot that did not fit through are taken to be the gap it failed at."""
TRIES = 2
"""Number of failures after which a passage is given up."""
KEPT = 256


class Gap(NamedTuple):
    """A gap that a robot did not fit through."""

    place: Point2D
    """Place of the robot in front of it, arena frame."""
    gap_m: float
    tries: int
    again_ns: int
    """Time when it may be tried again, unless it has been given up."""


class NarrowPassages:
    """Remembers failed attempts, and caches the map with narrow places."""

    def __init__(self) -> None:
        self.gaps: deque[Gap] = deque(maxlen=KEPT)
        self._failures: deque[tuple[Point2D, int]] = deque(maxlen=KEPT)
        self._navigation: NavigationGrid | None = None
        self._version: int
        """Of the map that `_navigation` was made from."""

    def record_gap(self, place: Point2D, gap_m: float, again_ns: int) -> None:
        """Record that a robot at `place` does not fit through the gap in front of it."""
        tries = 0
        for known in list(self.gaps):
            if known.place.distance_m(place) < SHUT_RADIUS_M:
                self.gaps.remove(known)
                tries = max(tries, known.tries)
        self.gaps.append(Gap(place, gap_m, tries + 1, again_ns))

    def record_failure(self, goal: Point2D) -> None:
        """Record that a robot sent along a narrow path did not reach its goal, for whatever reason."""
        tries = 0
        for known in list(self._failures):
            if known[0].distance_m(goal) < SHUT_RADIUS_M:
                self._failures.remove(known)
                tries = max(tries, known[1])
        self._failures.append((goal, tries + 1))

    def is_given_up(self, goal: Point2D) -> bool:
        """Whether robots have failed `TRIES` times to reach a place along narrow paths."""
        return any(tries >= TRIES and place.distance_m(goal) < SHUT_RADIUS_M for place, tries in self._failures)

    def shut(self, now_ns: int) -> list[tuple[float, float, float]]:
        """Circles (x, y, radius in metres, arena frame) through whose narrow places no robot may be sent now."""
        return [
            (gap.place.x_m, gap.place.y_m, SHUT_RADIUS_M)
            for gap in self.gaps
            if gap.tries >= TRIES or now_ns < gap.again_ns
        ]

    def look(self, grid: "OccupancyGrid", radius_m: float, preferred_m: float) -> "NavigationGrid":
        """The navigation grid for robots of this radius, narrow places included."""
        from robrain.algorithms.navigation.navigation_grid import NavigationGrid

        needed_m = min(preferred_m, mapped_clearance_m(radius_m, grid.geometry.resolution_m))
        known = self._navigation
        if known is None or (known.needed_m, known.preferred_m) != (needed_m, preferred_m):
            known = NavigationGrid(grid.classes(), grid.geometry, needed_m, preferred_m=preferred_m)
        elif self._version != grid.version:
            known.update(grid.classes())
        self._navigation, self._version = known, grid.version
        return known
