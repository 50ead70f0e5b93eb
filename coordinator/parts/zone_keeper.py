"""Keeps the team's zones, and publishes them."""

import msgspec

from robrain.coordinator.core.core import CoordinatorPart, Core
from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.team.zone_messages import (
    COORDINATOR_ZONES,
    COORDINATOR_ZONES_CHANGE,
    COORDINATOR_ZONES_NOW,
    ZoneChange,
    Zones,
)
from robrain.protocol.model.zone import Zone, check_zones
from robrain.protocol.wire.endpoint import Request, Serve

PERIOD_NS = to_ns(2.0)


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
        self.policy_changed(core.planning.policy)

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
        return Zones(zones=sorted(self._zones.values(), key=lambda zone: zone.name))

    def _set(self, zones: dict[str, Zone]) -> None:
        self._zones, self._due_ns = zones, 0
        self.core.team_map.set_zones([*zones.values()])
        self.core.assign_soon()


def _plain(zone: Zone) -> Zone:
    """A zone of a file as messages have it."""
    return Zone(**msgspec.structs.asdict(zone))
