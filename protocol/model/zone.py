"""Zones: parts of the floor with rules for robots."""

import math
from collections import Counter
from collections.abc import Sequence
from enum import StrEnum
from functools import lru_cache
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.checked import Checked, check_names
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.model.ranges import Length, Metres, Name, Pace, PositiveDuration, Radians, Stamp
from robrain.protocol.model.recurrence import Recurrence

ZONES_MAX = 256
CORNERS_MAX = 16_384
"""Of all zones together."""
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
    RESERVED = "reserved"
    """One robot of the team at a time drives there; the others wait outside."""
    DOOR = "door"
    """Robots have it opened, and drive there only while it is open."""
    DIRECTED = "one_way"
    """No robot drives there against `direction_rad`."""
    NO_STOPPING = "no_stopping"
    """Robots drive through, but do not wait or end there."""
    PLACE = "place"
    """It has a name and no rule. It may be a single point."""


FIELD_OF = {
    ZoneKind.SPEED_LIMIT: "speed_m_s",
    ZoneKind.PENALTY: "cost_m",
    ZoneKind.DIRECTED: "direction_rad",
}
"""The field that a kind needs; no other kind has it."""
NO_ENDING = {ZoneKind.KEEP_OUT: "keep-out", ZoneKind.NO_STOPPING: "no-stopping"}
"""Kinds of zones in which no task is done, in words."""


class ZoneTimes(Recurrence, frozen=True, kw_only=True):
    """The times at which a zone holds."""

    duration_s: PositiveDuration
    """How long it holds from each occurrence on."""


class Zone(Checked, frozen=True, kw_only=True):
    """A polygon of the floor with a name and a rule for robots. Tasks may name it: they are done at its centre."""

    name: Name
    kind: ZoneKind
    corners_m: Annotated[tuple[Corner, ...], Meta(min_length=1, max_length=4096)]
    """In order around the zone, metres, arena frame. The last is joined to the first. A side that is passed twice does
    not count, so a zone may have several parts and holes."""
    speed_m_s: Pace | None = None
    """Top speed in a zone of the kind `speed_limit`."""
    cost_m: Length | None = None
    """Extra cost of a metre in a zone of the kind `penalty`."""
    direction_rad: Radians | None = None
    """Direction of travel in a zone of the kind `one_way`, arena frame."""
    robots: Annotated[tuple[Name, ...], Meta(max_length=2000)] = ()
    """The robots that obey it: names of robots, or of plugins that a robot has; all robots if empty."""
    times: ZoneTimes | None = None
    """When it holds; always if None. Only the coordinator has it: robots receive the zones that hold now."""
    is_shut: bool = False
    """Whether no robot may drive there until it opens again: it is cleared, or a door does not open. The coordinator
    publishes keep-out zones with times as shut ones too."""
    shut_until_ns: Stamp | None = None
    """When a zone that is cleared opens; None if it is to be opened."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.kind is not ZoneKind.PLACE or self.is_shut) and self.area_m2 < AREA_MIN_M2:
            raise ValueError(f"zone {self.name}: expected corners_m around an area, got a point or a line")
        for kind, field in FIELD_OF.items():
            if (getattr(self, field) is None) == (self.kind is kind):
                expected = f"{field} with kind = {kind.value!r}" if self.kind is kind else f"no {field}"
                raise ValueError(f"zone {self.name}: expected {expected}")

    @property
    def rule(self) -> str:
        """Its rule in words."""
        if self.is_shut and self.kind not in (ZoneKind.DOOR, ZoneKind.KEEP_OUT):
            return "cleared, keep out"
        if self.speed_m_s is not None:
            return f"at most {self.speed_m_s:g} m/s"
        if self.kind is ZoneKind.PLACE:
            return f"place ({self.centre.x_m:g}, {self.centre.y_m:g})"
        if self.kind is ZoneKind.RESERVED:
            return "one robot at a time"
        if self.kind is ZoneKind.DOOR:
            return "door that does not open" if self.is_shut else "door"
        if self.direction_rad is not None:
            return f"one way, {math.degrees(self.direction_rad):.0f}°"
        if self.kind is ZoneKind.NO_STOPPING:
            return "no stopping"
        return "keep out" if self.cost_m is None else f"avoid, +{self.cost_m:g} m for each metre"

    @property
    def keeps_out(self) -> bool:
        """Whether robots that obey it must not drive there."""
        return self.kind is ZoneKind.KEEP_OUT or self.is_shut

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

    @property
    def sides(self) -> tuple[tuple[Corner, Corner], ...]:
        """Its border: the lower end of each side, then the upper one."""
        return _sides(self.corners_m)

    def holds(self, place: Point2D) -> bool:
        """Whether a place is inside: a line from it crosses the border an odd number of times."""
        x_m, y_m = place.x_m, place.y_m
        is_inside = False
        for (x0, y0), (x1, y1) in self.sides:
            if y0 <= y_m < y1 and (x_m - x0) * (y1 - y0) < (x1 - x0) * (y_m - y0):
                is_inside = not is_inside
        return is_inside

    def binds(self, robot: str) -> bool:
        """Whether a robot has to obey it."""
        return not self.robots or robot in self.robots


class ZoneTimesTable(ZoneTimes, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """`[planning.zones.times]`: the times at which a zone holds."""


class ZoneTable(Zone, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """`[[planning.zones]]`: a zone in a file."""

    times: ZoneTimesTable | None = None


AREA_MIN_M2 = 1e-4


@lru_cache(maxsize=4 * ZONES_MAX)
def _sides(corners_m: tuple[Corner, ...]) -> tuple[tuple[Corner, Corner], ...]:
    ends = zip(corners_m, (*corners_m[1:], corners_m[0]), strict=True)
    sides = Counter((one, other) if (one[1], one[0]) <= (other[1], other[0]) else (other, one) for one, other in ends)
    return tuple(side for side, count in sides.items() if count % 2 and side[0] != side[1])


SPEED_SLACK = 1.05
"""A robot may be faster than a limit by this factor."""
HAND_AHEAD_M = 0.5
"""The warning comes this far before a zone (chosen: two seconds at the usual speed of driving by hand)."""


def hand_warning(zones: Sequence[Zone], robot: str, pose: Pose2D, velocity: Twist2D) -> str:
    """Which zone a robot breaks that a person drives, in words; empty if none.

    Args:
        zones: those that hold.
        robot: its name.
        pose: T_arena_robot.
        velocity: of its body, body frame.

    """
    speed_m_s = math.hypot(velocity.forward_m_s, velocity.left_m_s)
    heading_rad = pose.yaw_rad + math.atan2(velocity.left_m_s, velocity.forward_m_s)
    ahead_m = min(HAND_AHEAD_M, 2.0 * speed_m_s)
    here = Point2D(pose.x_m, pose.y_m)
    ahead = Point2D(pose.x_m + ahead_m * math.cos(heading_rad), pose.y_m + ahead_m * math.sin(heading_rad))
    for zone in zones:
        if not zone.binds(robot) or not (zone.holds(here) or zone.holds(ahead)):
            continue
        is_against = zone.direction_rad is not None and math.cos(heading_rad - zone.direction_rad) < -1e-6
        is_fast = speed_m_s > SPEED_SLACK * (zone.speed_m_s or math.inf)
        if zone.keeps_out or is_fast or (is_against and speed_m_s > 0.0):
            return f"{robot} at {speed_m_s:.2f} m/s breaks the zone {zone.name}: {zone.rule}"
    return ""


def opened(zones: Sequence[Zone]) -> list[Zone]:
    """Zones once those have opened that open again."""
    kept = (zone for zone in zones if not (zone.is_shut and zone.kind is ZoneKind.KEEP_OUT))
    return [msgspec.structs.replace(zone, is_shut=False) if zone.is_shut else zone for zone in kept]


def check_zones(zones: Sequence[Zone]) -> None:
    """Check zones that are to hold together (ValueError)."""
    check_names("zone", ZONES_MAX, zones)
    if (corners := sum(len(zone.corners_m) for zone in zones)) > CORNERS_MAX:
        raise ValueError(f"expected at most {CORNERS_MAX} corners of all zones together, got {corners}")
