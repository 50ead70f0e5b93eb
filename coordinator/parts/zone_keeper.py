"""Keeps the team's zones, and publishes them."""

import msgspec

from robrain.coordinator.core.core import CoordinatorPart, Core
from robrain.coordinator.parts.changed_table import ChangedTable
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.clock import to_ns
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
        changes = self.stored(ZoneChanges).zones
        self._table = ChangedTable("zone", changes, check_zones, lambda zones: self.store(ZoneChanges(zones=zones)))
        self._zones: dict[str, Zone] = {}
        self._publisher = core.wire.publisher(COORDINATOR_ZONES)
        self._due_ns: int | None = None
        """When the zones are published next; None while there never were any."""
        core.wire.answer(COORDINATOR_ZONES_NOW, lambda _: self._message(), serve=Serve.IN_STEP)
        core.wire.answer(COORDINATOR_ZONES_CHANGE, self._change, serve=Serve.IN_STEP)
        self.policy_changed(core.planning.policy)

    def policy_changed(self, policy: PlanningPolicy) -> None:
        """Take the zones of another policy."""
        self._table.load(map(_plain, policy.zones))
        if self._table.rows != self._zones:
            self._apply()

    def publish(self, now_ns: int) -> None:
        """Publish all zones, if that is due."""
        if self._due_ns is not None and now_ns >= self._due_ns:
            self._due_ns = now_ns + PERIOD_NS
            self._publisher.put(self._message())

    def _change(self, request: Request[ZoneChange]) -> Zones:
        if self._table.change(request.asked.put, request.asked.remove):
            self._apply()
        return self._message()

    def _message(self) -> Zones:
        return Zones(zones=sorted(self._zones.values(), key=lambda zone: zone.name))

    def _apply(self) -> None:
        self._zones, self._due_ns = self._table.rows, 0
        self.core.team_map.set_zones([*self._zones.values()])
        self.core.assign_soon()


def _plain(zone: Zone) -> Zone:
    """A zone of a file as messages have it."""
    return Zone(**msgspec.structs.asdict(zone))
