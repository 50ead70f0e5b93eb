"""The team's zones, and changes of them."""

from datetime import datetime
from types import NoneType
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.clock import to_seconds
from robrain.protocol.errors import ErrorCode
from robrain.protocol.messages.message import Message
from robrain.protocol.model.ranges import Name, Names, PositiveDuration, Stamp, Text
from robrain.protocol.model.zone import ZONES_MAX, Zone
from robrain.protocol.topic import Delivery, Query, Topic, Urgency

ZoneList = Annotated[list[Zone], Meta(max_length=ZONES_MAX)]


class ZoneTurn(msgspec.Struct, frozen=True):
    """A zone that begins or ends."""

    zone: Name
    """Its name."""
    at_ns: Stamp
    """When it begins, or ends if it holds now."""


class Zones(Message, frozen=True, kw_only=True):
    """Zones of the team, by name: after a change, and every 2 s while there are any or were any."""

    zones: ZoneList
    """Those that hold now."""
    off: ZoneList = msgspec.field(default_factory=list)
    """Those that hold at other times."""
    turns: Annotated[list[ZoneTurn], Meta(max_length=ZONES_MAX)] = msgspec.field(default_factory=list)
    """When zones with times begin or end next."""

    @property
    def all(self) -> ZoneList:
        """All zones, by name."""
        return sorted((*self.zones, *self.off), key=lambda zone: zone.name)

    def turn_text(self, zone: Zone) -> str:
        """When a zone begins or ends next, in words and local time; empty if it never does."""
        turn_ns = next((turn.at_ns for turn in self.turns if turn.zone == zone.name), None)
        if turn_ns is None:
            return "" if zone in self.zones else "holds no more"
        word = "until" if zone in self.zones else "from"
        return f"{word} {datetime.fromtimestamp(to_seconds(turn_ns)).astimezone():%Y-%m-%d %H:%M}"


class ZoneChange(msgspec.Struct, frozen=True, kw_only=True):
    """Zones to add, to replace, to remove, to clear or to open."""

    put: ZoneList = []
    """New zones; each replaces the zone with its name, if there is one."""
    remove: Names = []
    """Names of zones that end."""
    clear: Names = []
    """Names of zones that all robots leave and no robot enters until they are opened."""
    clear_s: PositiveDuration | None = None
    """Time after which these zones open; None if they are to be opened."""
    open: Names = []
    """Names of zones to open that are cleared."""
    by: Text = ""
    """Name of the requester."""


COORDINATOR_ZONES = Topic(
    "coordinator/zones", "Zones of the team", Zones, rate_hz=0.5, delivery=Delivery.LATEST,
    urgency=Urgency.DATA_HIGH, recorded=True, max_bytes=1_048_576)  # fmt: skip
COORDINATOR_ZONES_NOW = Query(
    "coordinator/zones/now", "All zones of the team", NoneType, Zones, alias="coordinator_zones_now",
    urgency=Urgency.DATA_HIGH, reads_only=True)  # fmt: skip
COORDINATOR_ZONES_CHANGE = Query(
    "coordinator/zones/change", "Add, replace, remove, clear or open zones; replies all zones", ZoneChange, Zones,
    alias="coordinator_zones_change", urgency=Urgency.DATA_HIGH, errors=(ErrorCode.REFUSED, ))  # fmt: skip
