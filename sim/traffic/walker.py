"""Moving bodies of a floor: movers on their rounds, and people between their places."""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from robrain.protocol.messages.team.arena_messages import BodyKind
from robrain.protocol.model.geometry import Point2D
from robrain.sim.traffic.specs import MoverSpec, PeopleSpec

BESIDE_M = 0.1
"""Room beside a moving body that must be free of robots as well."""
PATIENCE_S = 4.0
"""Wait for a robot or a door after which a person goes somewhere else."""

Disc = tuple[float, float, float]
"""x, y, radius."""
Leg = tuple[list[Point2D], float]
"""Points ahead, and the pause before it sets out."""


class Rounds:
    """Legs of a mover: from point to point, in a circle or back and forth."""

    def __init__(self, via: Sequence[Point2D], pause_s: float, at_s: float, *, circles: bool) -> None:
        self._points = [*via] if circles else [*via, *reversed(via[1:-1])]
        self._at = 0
        self._pause_s = pause_s
        self._wait_s = at_s

    def begin(self) -> Point2D:
        """Its place at the start."""
        return self._points[0]

    def next_leg(self) -> Leg:
        """The path to the next point."""
        self._at = (self._at + 1) % len(self._points)
        wait_s, self._wait_s = self._wait_s, self._pause_s
        return [self._points[self._at]], wait_s

    def turns_back(self) -> bool:
        """A mover keeps to its path, however long it waits."""
        return False


class Errands:
    """Legs of a person: to places drawn at random.

    Args:
        places: between which it walks.
        paths: path from a place to another, by their numbers; all pairs have one.
        start: number of its first place.
        pause_s: shortest and longest stay.
        rng: draws places and stays.

    """

    def __init__(
        self,
        places: Sequence[Point2D],
        paths: Mapping[tuple[int, int], Sequence[Point2D]],
        start: int,
        pause_s: tuple[float, float],
        rng: np.random.Generator,
    ) -> None:
        self._places = places
        self._paths = paths
        self._from = self._to = start
        self._pause_s = pause_s
        self._rng = rng

    def begin(self) -> Point2D:
        """Its place at the start."""
        return self._places[self._to]

    def next_leg(self) -> Leg:
        """The path to another place."""
        others = [number for number in range(len(self._places)) if number != self._to]
        self._from, self._to = self._to, others[int(self._rng.integers(len(others)))]
        return [*self._paths[self._from, self._to][1:]], float(self._rng.uniform(*self._pause_s))

    def turns_back(self) -> bool:
        """It goes back to where it comes from."""
        self._from, self._to = self._to, self._from
        return True


class Walker:
    """One body on its path; stepped once a tick.

    Args:
        name: in the arena's truth.
        legs: its places.
        spec: its shape and speed.

    """

    def __init__(self, name: str, legs: Rounds | Errands, spec: MoverSpec | PeopleSpec) -> None:
        self.name = name
        self.size_m: tuple[float, float] | None = None
        """Length and width; None for a round body."""
        self.kind, self.radius_m = BodyKind.PERSON, spec.radius_m
        if isinstance(spec, MoverSpec):
            self.kind, self.size_m, self.radius_m = BodyKind.MOVER, spec.size_m, spec.reach_m
        self._legs = legs
        self._speed_m_s, self._stop_m = spec.speed_m_s, spec.stop_m
        begin = legs.begin()
        self.x_m, self.y_m = begin.x_m, begin.y_m
        """Its place, arena frame."""
        self.along = (1.0, 0.0)
        """Direction of its path, a unit vector."""
        self._ahead, self._pause_s = legs.next_leg()
        self._passed = [begin]
        """Points of this leg that it has come by."""
        self._waits_s = 0.0
        self._turn()

    def step(self, tick_s: float, robots: Sequence[Disc], blocks: Callable[[float, float, float], bool]) -> None:
        """Advance by a tick, unless a robot or a closed door is on the path.

        Args:
            tick_s: duration of the tick.
            robots: hulls of the robots.
            blocks: whether a closed door is within a distance of a place: x, y, distance.

        """
        if self._pause_s > 0:
            self._pause_s -= tick_s
            return
        step_m = self._speed_m_s * tick_s
        x_m, y_m = self.x_m + step_m * self.along[0], self.y_m + step_m * self.along[1]
        if self._is_held(robots) or blocks(x_m, y_m, self.radius_m):
            self._wait(tick_s)
            return
        self._waits_s = 0.0
        target = self._ahead[0]
        if self._distance_m(target) > step_m:
            self.x_m, self.y_m = x_m, y_m
            return
        self.x_m, self.y_m = target.x_m, target.y_m
        self._passed.append(self._ahead.pop(0))
        if not self._ahead:
            self._ahead, self._pause_s = self._legs.next_leg()
            self._passed = [target]
        self._turn()

    def _is_held(self, robots: Sequence[Disc]) -> bool:
        if self._stop_m <= 0:
            return False
        along_x, along_y = self.along
        for x_m, y_m, radius_m in robots:
            off_x_m, off_y_m = x_m - self.x_m, y_m - self.y_m
            ahead_m = off_x_m * along_x + off_y_m * along_y
            beside_m = abs(off_y_m * along_x - off_x_m * along_y)
            together_m = self.radius_m + radius_m
            gap_m = math.sqrt(off_x_m * off_x_m + off_y_m * off_y_m) - together_m
            if ahead_m > 0 and gap_m < self._stop_m and beside_m < together_m + BESIDE_M:
                return True
        return False

    def _wait(self, tick_s: float) -> None:
        self._waits_s += tick_s
        if self._waits_s >= PATIENCE_S:
            self._waits_s = 0.0
            if self._legs.turns_back():
                self._ahead, self._passed = self._passed[::-1], self._ahead[::-1]
                self._turn()

    def _turn(self) -> None:
        target = self._ahead[0]
        distance_m = self._distance_m(target)
        if distance_m > 0:
            self.along = (target.x_m - self.x_m) / distance_m, (target.y_m - self.y_m) / distance_m

    def _distance_m(self, target: Point2D) -> float:
        off_x_m, off_y_m = target.x_m - self.x_m, target.y_m - self.y_m
        return math.sqrt(off_x_m * off_x_m + off_y_m * off_y_m)
