"""Keeps the team's zones, and publishes them."""

import msgspec

from robrain.coordinator.core.core import CoordinatorPart, Core
from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.border.border import Received
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.team.door_messages import DOOR_STATE, DoorPosition
from robrain.protocol.messages.team.zone_messages import (
    COORDINATOR_ZONES,
    COORDINATOR_ZONES_CHANGE,
    COORDINATOR_ZONES_NOW,
    ZoneChange,
    Zones,
)
from robrain.protocol.model.zone import Zone, ZoneKind, check_zones
from robrain.protocol.wire.endpoint import Request, Serve

PERIOD_NS = to_ns(2.0)
DOOR_SILENT_NS = to_ns(10.0)
"""A door that has not reported for longer cannot be used (chosen: it reports once a second)."""


class ZoneChanges(msgspec.Struct, frozen=True):
    """Changes of zones while the team ran."""

    zones: dict[str, Zone | None] = {}
    """Zones that were added, replaced or removed (None), by name."""


class ZoneKeeper(CoordinatorPart):
    """Zones of the policy and their changes: robots, plans, exploration and admission obey them.

    Args:
        core: the team.

    """

    def __init__(self, core: Core) -> None:
        super().__init__(core)
        self._zones: dict[str, Zone] = {}
        self._changes = self.stored(ZoneChanges).zones
        self._publisher = core.wire.publisher(COORDINATOR_ZONES)
        self._due_ns: int | None = None
        """When the zones are published next; None while there never were any."""
        core.wire.answer(COORDINATOR_ZONES_NOW, lambda _: self._message(), serve=Serve.IN_STEP)
        core.wire.answer(COORDINATOR_ZONES_CHANGE, self._change, serve=Serve.IN_STEP)
        self._doors: dict[str, tuple[DoorPosition, int]] = {}
        """The last position of each door, and when it arrived."""
        self._shut: set[str] = set()
        """Doors that cannot be used now."""
        self._began_ns = core.wire.clock.now_ns()
        self.subscribe(DOOR_STATE)
        self.policy_changed(core.planning.policy)

    def handle(self, received: Received, now_ns: int) -> None:
        """Take the position of a door."""
        self._doors[received.message.door] = received.message.position, now_ns

    def check(self, now_ns: int) -> None:
        """Shut doors that have failed or are silent, and open them again."""
        shut = set()
        for zone in self._zones.values():
            position, received_ns = self._doors.get(zone.name, (None, self._began_ns))
            is_silent = now_ns - received_ns > DOOR_SILENT_NS
            if zone.kind is ZoneKind.DOOR and (is_silent or position is DoorPosition.FAILED):
                shut.add(zone.name)
        if shut != self._shut:
            self._shut = shut
            self._set(self._zones)

    def policy_changed(self, policy: PlanningPolicy) -> None:
        """Take the zones of another policy."""
        zones = {zone.name: _plain(zone) for zone in policy.zones} | self._changes
        kept = {name: zone for name, zone in zones.items() if zone is not None}
        if kept != self._zones:
            self._set(kept)

    def publish(self, now_ns: int) -> None:
        """Publish all zones, if that is due."""
        if self._due_ns is not None and now_ns >= self._due_ns:
            self._due_ns = now_ns + PERIOD_NS
            self._publisher.put(self._message())

    def _change(self, request: Request[ZoneChange]) -> Zones:
        asked = request.asked
        if unknown := [name for name in asked.remove if name not in self._zones]:
            known = ", ".join(self._zones) or "none"
            raise CallError(ErrorCode.REFUSED, f"there is no zone {unknown[0]}; known are {known}")
        changes = dict.fromkeys(asked.remove) | {zone.name: zone for zone in asked.put}
        zones = {name: zone for name, zone in (self._zones | changes).items() if zone is not None}
        try:
            check_zones([*zones.values()])
            check_zones(asked.put)
            if changes:
                self.store(ZoneChanges(zones=self._changes | changes))
        except (ValueError, JournalUnwritable) as error:
            raise CallError(ErrorCode.REFUSED, str(error)) from error
        if changes:
            self._changes |= changes
            self._set(zones)
        return self._message()

    def _message(self) -> Zones:
        return Zones(zones=sorted(self._obeyed(), key=lambda zone: zone.name))

    def _obeyed(self) -> list[Zone]:
        """The zones as robots obey them now."""
        return [
            msgspec.structs.replace(zone, is_shut=True) if zone.kind is ZoneKind.DOOR and name in self._shut else zone
            for name, zone in self._zones.items()
        ]

    def _set(self, zones: dict[str, Zone]) -> None:
        self._zones, self._due_ns = zones, 0
        self.core.team_map.set_zones(self._obeyed())
        self.core.assign_soon()


def _plain(zone: Zone) -> Zone:
    """A zone of a file as messages have it."""
    return Zone(**msgspec.structs.asdict(zone))
