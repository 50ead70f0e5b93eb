"""Floor that exploration did not cover: the regions that robots did not see or cannot reach, each with a reason."""

from enum import StrEnum
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.messages.message import Message
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Count, Length

REGIONS_MAX = 64
"""Regions named one by one; of smaller ones only number and area are published."""
Area = Annotated[float, Meta(ge=0.0, le=1e12)]
"""Square metres."""


class LeftKind(StrEnum):
    """Why a region is left."""

    TOO_NARROW = "too_narrow"
    """It has been seen, but the widest path there has a gap too narrow for the robots."""
    UNREACHABLE = "unreachable"
    """It has been seen, but the map shows no path there at all: it lies behind glass or a fence."""
    TRIED = "tried"
    """Robots were sent there and failed repeatedly."""
    CUT_OFF = "cut_off"
    """An obstacle blocks a path that robots have used before, such as a closed door."""
    UNSEEN = "unseen"
    """Robots have a path to its edge and were not sent there: time or energy ran out."""


class RegionLeft(msgspec.Struct, frozen=True, kw_only=True):
    """One region, arena frame."""

    kind: LeftKind
    place: Point2D
    """A point of it: for `unseen` and `tried` at its edge, where robots can look in; else the one farthest from its
    edge."""
    area_m2: Area
    """Area of its floor that has been seen. Where robots can look in, an estimate: the unknown area within 2 m of its
    edge that no known wall hides."""
    low: Point2D
    """Corner of its bounding box with the least x and y."""
    high: Point2D
    """Corner of its bounding box with the greatest x and y."""
    gap_m: Length | None = None
    """`too_narrow`: width of the gap; as a robot measured it, else as on the map, to within one cell of the map.
    `unseen`: the same, if the path there is narrower than robots prefer and may prove too narrow."""
    needed_m: Length | None = None
    """Width of the narrowest gap that the robots drive through; None if `gap_m` is."""
    gap_at: Point2D | None = None
    """`too_narrow`: where a robot stood in front of the gap; None if no robot has measured it."""
    tries: Count = 0
    """Number of failures of robots to get there."""

    @property
    def words(self) -> str:
        """Why it is left, for people."""
        by = "measured" if self.gap_at is not None else "on the map"
        gap = f"the gap is {self.gap_m or 0.0:.2f} m wide ({by}), robots need {self.needed_m or 0.0:.2f} m"
        match self.kind:
            case LeftKind.TOO_NARROW:
                return gap
            case LeftKind.UNREACHABLE:
                return "seen, but there is no way there"
            case LeftKind.TRIED:
                return f"robots failed to get there {self.tries} times"
            case LeftKind.CUT_OFF:
                return "was reachable before, the way is blocked now"
            case LeftKind.UNSEEN:
                return "can be reached, has not been seen" if self.gap_m is None else f"not seen; {gap}"


class ExplorationLeft(Message, frozen=True, kw_only=True):
    """All regions that exploration has not covered, by the team's map."""

    regions: Annotated[list[RegionLeft], Meta(max_length=REGIONS_MAX)] = msgspec.field(default_factory=list)
    """Largest first."""
    more: Count = 0
    """Number of regions that are smaller than these."""
    more_m2: Area = 0.0
    """Area of those."""
