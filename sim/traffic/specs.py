"""Doors, moving obstacles and people, as a scenario describes them."""

import math
from collections.abc import Sequence

import msgspec

from robrain.protocol.model.ranges import check_not_negative, check_positive, check_within

MAX_PEOPLE = 200
"""In one table."""
LONGEST_S = 1e6


class DoorSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[[doors]]`: a door that opens and closes by a timetable: either `open_s` or `period_s`.

    A closed door is a wall for robots, sensors and people. A door that would close on somebody waits until the way is
    clear. The floor behind counts as reachable. Raises ValueError for impossible values.
    """

    from_m: tuple[float, float]
    """One end: x and y."""
    to_m: tuple[float, float]
    """The other end."""
    thickness_m: float = 0.1
    open_s: tuple[tuple[float, float], ...] | None = None
    """Intervals of simulated time in which it is open, in order."""
    period_s: float | None = None
    """Time from one opening to the next."""
    open_share: float = 0.5
    """With `period_s`: share of the period in which it is open."""
    phase_s: float | None = None
    """With `period_s`: time of the first opening; drawn from the seed if absent."""

    def __post_init__(self) -> None:
        _check_points(self, "from_m", "to_m")
        if self.from_m == self.to_m:
            raise ValueError(f"expected to_m different from from_m, got {list(self.to_m)} for both")
        check_positive(self, "thickness_m", below=math.inf)
        if (self.open_s is None) == (self.period_s is None):
            raise ValueError("expected either open_s or period_s")
        check_within(self, 0, 1, "open_share")
        before_s = 0.0
        for opens_s, closes_s in self.open_s or ():
            if not before_s <= opens_s < closes_s:
                raise ValueError(
                    f"expected open_s as intervals in order, got {[list(one) for one in self.open_s or ()]}"
                )
            before_s = closes_s
        if self.period_s is not None:
            check_positive(self, "period_s", below=math.inf)
        elif self.phase_s is not None:
            raise ValueError("expected phase_s only with period_s")
        if self.phase_s is not None:
            check_not_negative(self, "phase_s", finite=True)


class MoverSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[[movers]]`: an obstacle that moves along straight lines between points: a disc, or a box with `size_m`.

    Raises ValueError for impossible values.
    """

    via_m: tuple[tuple[float, float], ...]
    """Points on its way, at least two; it begins at the first."""
    radius_m: float = 0.3
    """Radius of a disc."""
    size_m: tuple[float, float] | None = None
    """Length along its way and width of a box; a disc if absent."""
    speed_m_s: float = 0.5
    pause_s: float = 2.0
    """Stay at each point."""
    at_s: float = 0.0
    """Simulated time at which it sets out."""
    circles: bool = False
    """Whether it goes from the last point straight to the first; if not, it goes back the way it came."""
    stop_m: float = 0.6
    """It stands while a robot is in its way and nearer than this; with 0 it stops for nobody."""

    def __post_init__(self) -> None:
        _check_walk(self)
        if len(self.via_m) < 2:
            raise ValueError(f"expected at least two points in via_m, got {len(self.via_m)}")
        _check_points(self, "via_m")
        for one, other in zip(self.via_m, self.via_m[1:], strict=False):
            if one == other:
                raise ValueError(f"expected each point of via_m apart from the next, got {list(one)} twice")
        if self.circles and self.via_m[0] == self.via_m[-1]:
            raise ValueError("expected the last point of via_m apart from the first: circles adds the way back")
        if self.size_m is not None and not all(0 < side_m < math.inf for side_m in self.size_m):
            raise ValueError(f"expected sides above 0 in size_m, got {list(self.size_m)}")
        check_not_negative(self, "pause_s", "at_s", finite=True)


class PeopleSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[[people]]`: people, as discs, who walk between places, each to one drawn at random, and stop for robots.

    They take the shortest way around walls, and wait at closed doors. Raises ValueError for impossible values.
    """

    count: int = 1
    places_m: tuple[tuple[float, float], ...] = ()
    """Places between which they walk; eight drawn from the seed if absent."""
    radius_m: float = 0.2
    speed_m_s: float = 0.8
    pause_s: tuple[float, float] = (2.0, 15.0)
    """Shortest and longest stay at a place."""
    stop_m: float = 0.6
    """They stand while a robot is in their way and nearer than this; with 0 they stop for nobody."""

    def __post_init__(self) -> None:
        _check_walk(self)
        check_within(self, 1, MAX_PEOPLE, "count")
        if len(self.places_m) == 1:
            raise ValueError("expected at least two places_m, got 1")
        _check_points(self, "places_m")
        least_s, greatest_s = self.pause_s
        if not 0 <= least_s <= greatest_s <= LONGEST_S:
            raise ValueError(f"expected pause_s as [shortest, longest] from 0 s, got {list(self.pause_s)}")


class TrafficSpec(msgspec.Struct, frozen=True, kw_only=True):
    """Everything on a floor that moves and is no robot."""

    doors: tuple[DoorSpec, ...] = ()
    movers: tuple[MoverSpec, ...] = ()
    people: tuple[PeopleSpec, ...] = ()

    @property
    def is_on(self) -> bool:
        """Whether there is anything."""
        return bool(self.doors or self.movers or self.people)


def _check_walk(spec: MoverSpec | PeopleSpec) -> None:
    check_positive(spec, "radius_m", "speed_m_s", below=math.inf)
    check_not_negative(spec, "stop_m", finite=True)


def _check_points(spec: msgspec.Struct, *names: str) -> None:
    for name in names:
        value: Sequence[object] = getattr(spec, name)
        points = value if value and isinstance(value[0], tuple) else [value]
        if not all(math.isfinite(number) for point in points for number in point):  # type: ignore[attr-defined]
            raise ValueError(f"expected finite coordinates in {name}, got {value}")
