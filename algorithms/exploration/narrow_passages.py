"""Gaps that robots did not fit through. Imports no kernels: a coordinator loads them once it is up."""

from collections import deque
from typing import TYPE_CHECKING, NamedTuple, TypeVar

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


class Tried(NamedTuple):
    """A place that robots failed to get to, arena frame."""

    place: Point2D
    tries: int


class Gap(NamedTuple):
    """A gap that a robot did not fit through."""

    place: Point2D
    """Place of the robot in front of it, arena frame."""
    gap_m: float
    tries: int
    again_ns: int
    """Time when it may be tried again, unless it has been given up."""


Kind = TypeVar("Kind", Tried, Gap)


def forget_near(known: deque[Kind], place: Point2D) -> int:
    """Forget what is known near a place; returns the largest number of tries there."""
    near = [one for one in known if one.place.distance_m(place) < SHUT_RADIUS_M]
    for one in near:
        known.remove(one)
    return max((one.tries for one in near), default=0)


def record_tried(known: deque[Tried], place: Point2D) -> None:
    """Record a failure to get to a place, together with those near it."""
    known.append(Tried(place, forget_near(known, place) + 1))


class NarrowPassages:
    """Remembers failed attempts, and caches the map with narrow places."""

    def __init__(self) -> None:
        self.gaps: deque[Gap] = deque(maxlen=KEPT)
        self._failures: deque[Tried] = deque(maxlen=KEPT)
        self._navigation: NavigationGrid | None = None
        self._version: int
        """Of the map that `_navigation` was made from."""

    def record_gap(self, place: Point2D, gap_m: float, again_ns: int) -> None:
        """Record that a robot at `place` does not fit through the gap in front of it."""
        self.gaps.append(Gap(place, gap_m, forget_near(self.gaps, place) + 1, again_ns))

    def record_failure(self, goal: Point2D) -> None:
        """Record that a robot sent along a narrow path did not reach its goal, for whatever reason."""
        record_tried(self._failures, goal)

    def is_given_up(self, goal: Point2D) -> bool:
        """Whether robots have failed `TRIES` times to reach a place along narrow paths."""
        return any(one.tries >= TRIES and one.place.distance_m(goal) < SHUT_RADIUS_M for one in self._failures)

    def shut(self, now_ns: int) -> list[tuple[float, float, float]]:
        """Circles (x, y, radius in metres, arena frame) through whose narrow places no robot may be sent now."""
        return [
            (gap.place.x_m, gap.place.y_m, SHUT_RADIUS_M)
            for gap in self.gaps
            if gap.tries >= TRIES or now_ns < gap.again_ns
        ]

    def navigation(self, grid: "OccupancyGrid", radius_m: float, preferred_m: float) -> "NavigationGrid":
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
