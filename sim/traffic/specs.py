"""Doors, moving obstacles and people, as a scenario describes them."""

import math
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import Name, NotNegative, Positive, Share

ROBOT_COLLISION, WALL_COLLISION, MOVER_COLLISION = 1, 2, 3
"""Collision types of shapes in the arena's space."""
FRICTION = 0.4

MAX_PEOPLE = 200
"""In one table."""
LONGEST_S = 1e6


class DoorSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[[doors]]`: a door that opens by a timetable, `open_s` or `period_s`, or on robots' requests, `opening_s`.

    A closed door is a wall for robots, sensors and people. A door that would close on a body waits until its area is
    clear. The floor behind counts as reachable. Raises ValueError for impossible values.
    """

    from_m: tuple[float, float]
    """One end: x and y."""
    to_m: tuple[float, float]
    """The other end."""
    thickness_m: Positive = 0.1
    open_s: tuple[tuple[float, float], ...] | None = None
    """Intervals of simulated time in which it is open, in order."""
    period_s: Positive | None = None
    """Time from one opening to the next."""
    open_share: Share = 0.5
    """With `period_s`: share of the period in which it is open."""
    phase_s: NotNegative | None = None
    """With `period_s`: time of the first opening; drawn from the seed if absent."""
    opening_s: Positive | None = None
    """Time that it takes to open on request."""
    name: Name = ""
    """With `opening_s`: the name of its zone of the kind `door`."""
    stuck_s: tuple[tuple[float, float], ...] = ()
    """With `opening_s`: intervals of simulated time in which it does not open."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.from_m == self.to_m:
            raise ValueError(f"expected to_m different from from_m, got {list(self.to_m)} for both")
        if [self.open_s, self.period_s, self.opening_s].count(None) != 2:
            raise ValueError("expected one of open_s, period_s and opening_s")
        if (self.opening_s is None) == bool(self.name) or (self.stuck_s and not self.name):
            raise ValueError("expected name with opening_s, and stuck_s for such a door alone")
        before_s = 0.0
        for opens_s, closes_s in self.open_s or ():
            if not before_s <= opens_s < closes_s:
                raise ValueError(
                    f"expected open_s as intervals in order, got {[list(one) for one in self.open_s or ()]}"
                )
            before_s = closes_s
        if self.period_s is None and self.phase_s is not None:
            raise ValueError("expected phase_s only with period_s")


class MoverSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[[movers]]`: an obstacle that moves along straight lines between points: a disc, or a box with `size_m`.

    Raises ValueError for impossible values.
    """

    via_m: tuple[tuple[float, float], ...]
    """Points on its path, at least two; it begins at the first."""
    radius_m: Positive = 0.3
    """Radius of a disc."""
    size_m: tuple[float, float] | None = None
    """Length along its path and width of a box; a disc if absent."""
    speed_m_s: Positive = 0.5
    pause_s: NotNegative = 2.0
    """Stay at each point."""
    at_s: NotNegative = 0.0
    """Simulated time at which it sets out."""
    circles: bool = False
    """Whether it goes from the last point straight to the first; if not, it returns along its path."""
    stop_m: NotNegative = 0.6
    """It stands while a robot is on its path and nearer than this; with 0 it never stops."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.via_m) < 2:
            raise ValueError(f"expected at least two points in via_m, got {len(self.via_m)}")
        for one, other in zip(self.via_m, self.via_m[1:], strict=False):
            if one == other:
                raise ValueError(f"expected each point of via_m apart from the next, got {list(one)} twice")
        if self.circles and self.via_m[0] == self.via_m[-1]:
            raise ValueError("expected the last point of via_m apart from the first: circles adds the way back")
        if self.size_m is not None and not all(0 < side_m < math.inf for side_m in self.size_m):
            raise ValueError(f"expected sides above 0 in size_m, got {list(self.size_m)}")

    @property
    def reach_m(self) -> float:
        """Radius of the disc about its middle that holds it."""
        if self.size_m is None:
            return self.radius_m
        length_m, width_m = self.size_m
        return math.sqrt(length_m * length_m + width_m * width_m) / 2


class PeopleSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[[people]]`: people, as discs, who walk between places, each to one drawn at random, and stop for robots.

    They use the shortest path around walls, and wait at closed doors. Raises ValueError for impossible values.
    """

    count: Annotated[int, Meta(ge=1, le=MAX_PEOPLE)] = 1
    places_m: tuple[tuple[float, float], ...] = ()
    """Places between which they walk; eight drawn from the seed if absent."""
    radius_m: Positive = 0.2
    speed_m_s: Positive = 0.8
    pause_s: tuple[float, float] = (2.0, 15.0)
    """Shortest and longest stay at a place."""
    stop_m: NotNegative = 0.6
    """They stand while a robot is on their path and nearer than this; with 0 they never stop."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.places_m) == 1:
            raise ValueError("expected at least two places_m, got 1")
        least_s, greatest_s = self.pause_s
        if not 0 <= least_s <= greatest_s <= LONGEST_S:
            raise ValueError(f"expected pause_s as [shortest, longest] from 0 s, got {list(self.pause_s)}")


class TrafficSpec(msgspec.Struct, frozen=True, kw_only=True):
    """All moving bodies of a floor that are no robots."""

    doors: tuple[DoorSpec, ...] = ()
    movers: tuple[MoverSpec, ...] = ()
    people: tuple[PeopleSpec, ...] = ()

    @property
    def is_on(self) -> bool:
        """Whether there are any."""
        return bool(self.doors or self.movers or self.people)
