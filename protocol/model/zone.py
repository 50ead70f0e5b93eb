"""Zones: parts of the floor with rules for robots."""

from collections.abc import Sequence
from enum import StrEnum
from typing import Annotated

from msgspec import Meta

from robrain.protocol.model.checked import Checked, check_names
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Length, Metres, Name, Pace

ZONES_MAX = 256
Corner = tuple[Metres, Metres]
"""x and y, arena frame."""


class ZoneKind(StrEnum):
    """Rule of a zone."""

    KEEP_OUT = "keep_out"
    """No robot drives there. One that stands inside leaves by the shortest way."""
    SPEED_LIMIT = "speed_limit"
    """Robots drive at most at `speed_m_s`."""
    PENALTY = "penalty"
    """Paths avoid it: a metre there counts like `cost_m` metres more."""
    PLACE = "place"
    """It has a name and no rule. It may be a single point."""


FIELD_OF = {ZoneKind.SPEED_LIMIT: "speed_m_s", ZoneKind.PENALTY: "cost_m"}
"""The field that a kind needs; no other kind has it."""


class Zone(Checked, frozen=True, kw_only=True):
    """A polygon of the floor with a name and a rule for robots. Tasks may name it: they are done at its centre."""

    name: Name
    kind: ZoneKind
    corners_m: Annotated[tuple[Corner, ...], Meta(min_length=1, max_length=64)]
    """In order around the zone, metres, arena frame. The last is joined to the first."""
    speed_m_s: Pace | None = None
    """Top speed in a zone of the kind `speed_limit`."""
    cost_m: Length | None = None
    """Extra cost of a metre in a zone of the kind `penalty`."""
    robots: Annotated[tuple[Name, ...], Meta(max_length=1000)] = ()
    """Names of the robots that obey it; all if empty."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind is not ZoneKind.PLACE and self.area_m2 < AREA_MIN_M2:
            raise ValueError(f"zone {self.name}: expected corners_m around an area, got a point or a line")
        for kind, field in FIELD_OF.items():
            if (getattr(self, field) is None) == (self.kind is kind):
                expected = f"{field} with kind = {kind.value!r}" if self.kind is kind else f"no {field}"
                raise ValueError(f"zone {self.name}: expected {expected}")

    @property
    def rule(self) -> str:
        """Its rule in words."""
        if self.speed_m_s is not None:
            return f"at most {self.speed_m_s:g} m/s"
        if self.kind is ZoneKind.PLACE:
            return f"place ({self.centre.x_m:g}, {self.centre.y_m:g})"
        return "keep out" if self.cost_m is None else f"avoid, +{self.cost_m:g} m for each metre"

    @property
    def centre(self) -> Point2D:
        """The mean of its corners."""
        xs_m, ys_m = zip(*self.corners_m, strict=True)
        return Point2D(sum(xs_m) / len(xs_m), sum(ys_m) / len(ys_m))

    @property
    def area_m2(self) -> float:
        """Area, by the shoelace formula."""
        ends = (*self.corners_m[1:], self.corners_m[0])
        return abs(sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in zip(self.corners_m, ends, strict=True))) / 2.0

    def holds(self, place: Point2D) -> bool:
        """Whether a place is inside: a line from it crosses the border an odd number of times."""
        is_inside = False
        for (x0, y0), (x1, y1) in zip(self.corners_m, (*self.corners_m[1:], self.corners_m[0]), strict=True):
            if (y0 > place.y_m) != (y1 > place.y_m) and place.x_m < x0 + (x1 - x0) * (place.y_m - y0) / (y1 - y0):
                is_inside = not is_inside
        return is_inside

    def binds(self, robot: str) -> bool:
        """Whether a robot has to obey it."""
        return not self.robots or robot in self.robots


class ZoneTable(Zone, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[[planning.zones]]`: a zone in a file."""


AREA_MIN_M2 = 1e-4


def check_zones(zones: Sequence[Zone]) -> None:
    """Check zones that are to hold together (ValueError)."""
    check_names("zone", ZONES_MAX, zones)
