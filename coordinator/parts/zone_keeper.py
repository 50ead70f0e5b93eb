"""Keeps the team's zones, and publishes them."""

import msgspec

from robrain.coordinator.core.core import CoordinatorPart, Core
from robrain.coordinator.parts.changed_table import ChangedTable
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
    ZoneTurn,
)
from robrain.protocol.model.recurrence import Occurrences
from robrain.protocol.model.zone import Zone, ZoneKind, ZoneTimes, check_zones
from robrain.protocol.wire.endpoint import Request, Serve

PERIOD_NS = to_ns(2.0)
DOOR_SILENT_NS = to_ns(10.0)
"""A door that has not reported for longer cannot be used (chosen: it reports once a second)."""


class ZoneChanges(msgspec.Struct, frozen=True):
    """Changes of zones while the team ran."""

    zones: dict[str, Zone | None] = {}
    """Zones that were added, replaced or removed (None), by name."""


class ZoneTimer:
    """Times of a zone.

    Args:
        times: at which it holds.
        now_ns: the time.

    """

    def __init__(self, times: ZoneTimes, now_ns: int) -> None:
        self._duration_ns = to_ns(times.duration_s)
        self._occurrences = Occurrences(times, now_ns - self._duration_ns)
        self._until_ns = now_ns

    def holds(self, now_ns: int) -> bool:
        """Whether the zone holds now."""
        if (begun_ns := self._occurrences.latest_ns(now_ns)) is not None:
            self._until_ns = begun_ns + self._duration_ns
        return now_ns < self._until_ns

    def turn_ns(self, now_ns: int) -> int | None:
        """When that changes; None if it never does again."""
        return self._until_ns if now_ns < self._until_ns else self._occurrences.next_ns


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
        self._timers: dict[str, ZoneTimer] = {}
        self._turns: list[ZoneTurn] = []
        """When zones with times begin or end next, and cleared ones open."""
        self._cleared: set[str] = set()
        """Zones that all robots leave, and none enters."""
        self._off: set[str] = set()
        """Zones that do not hold now."""
        self._holding: list[Zone] = []
        """Those that hold, as robots receive them."""
        self._offers_version = 0
        self._publisher = core.wire.publisher(COORDINATOR_ZONES)
        self._due_ns: int | None = None
        """When the zones are published next; None while there never were any."""
        core.wire.answer(COORDINATOR_ZONES_NOW, lambda _: self._all(), serve=Serve.IN_STEP)
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
            self._update(now_ns)

    def policy_changed(self, policy: PlanningPolicy) -> None:
        """Take the zones of another policy."""
        self._table.load(map(_plain, policy.zones))
        if self._table.rows != self._zones:
            self._apply()

    def decide(self, now_ns: int) -> None:
        """Begin and end zones by their times, and follow which robots have the plugins that zones name."""
        version = self.core.capabilities.version
        if version != self._offers_version or any(now_ns >= turn.at_ns for turn in self._turns):
            self._offers_version = version
            self._update(now_ns)

    def publish(self, now_ns: int) -> None:
        """Publish all zones, if that is due."""
        if self._due_ns is not None and now_ns >= self._due_ns:
            self._due_ns = now_ns + PERIOD_NS
            off = [msgspec.structs.replace(self._zones[name], times=None) for name in sorted(self._off)]
            self._publisher.put(Zones(zones=self._holding, off=off, turns=self._turns))

    def _change(self, request: Request[ZoneChange]) -> Zones:
        asked, now_ns = request.asked, self.core.wire.clock.now_ns()
        until_ns = None if asked.clear_s is None else now_ns + to_ns(asked.clear_s)
        turned = [(name, True, until_ns) for name in asked.clear] + [(name, False, None) for name in asked.open]
        try:
            put = [
                msgspec.structs.replace(self._table.find(name), is_shut=is_shut, shut_until_ns=until_ns)
                for name, is_shut, until_ns in turned
            ]
        except ValueError as error:
            raise CallError(ErrorCode.REFUSED, str(error)) from error
        if self._table.change([*asked.put, *put], asked.remove):
            self._apply()
        return self._all()

    def _all(self) -> Zones:
        zones = sorted(self._zones.values(), key=lambda zone: zone.name)
        holding = [self._as_now(zone) for zone in zones if zone.name not in self._off]
        return Zones(zones=holding, off=[zone for zone in zones if zone.name in self._off], turns=self._turns)

    def _apply(self) -> None:
        now_ns = self.core.wire.clock.now_ns()
        self._zones = self._table.rows
        timed = {name: zone.times for name, zone in self._zones.items() if zone.times is not None}
        self._timers = {name: ZoneTimer(times, now_ns) for name, times in timed.items()}
        self._due_ns = 0
        self._update(now_ns)

    def _update(self, now_ns: int) -> None:
        ends_ns = {name: zone.shut_until_ns for name, zone in self._zones.items() if zone.is_shut}
        self._cleared = {name for name, end_ns in ends_ns.items() if end_ns is None or now_ns < end_ns}
        self._off = {name for name, timer in self._timers.items() if not timer.holds(now_ns)} - self._cleared
        turns = {name: timer.turn_ns(now_ns) for name, timer in self._timers.items()}
        turns |= {name: ends_ns[name] for name in self._cleared}
        self._turns = [ZoneTurn(name, turn_ns) for name, turn_ns in sorted(turns.items()) if turn_ns is not None]
        holding = [self._for_robots(self._zones[name]) for name in sorted(self._zones) if name not in self._off]
        if holding != self._holding:
            self._holding, self._due_ns = holding, 0
            self.core.team_map.set_zones(holding)
            self.core.assign_soon()

    def _for_robots(self, zone: Zone) -> Zone:
        """The zone as robots receive it: always in force, with the names of all robots that obey it."""
        offers = self.core.capabilities.plugins if zone.robots else {}
        names = [
            name for name in sorted(offers) if name not in zone.robots and set(zone.robots) & (offers[name] or set())
        ]
        robots = () if zone.name in self._cleared else (*zone.robots, *names)
        is_passing = zone.kind is ZoneKind.KEEP_OUT and zone.times is not None
        found = self._as_now(zone)
        return msgspec.structs.replace(found, times=None, robots=robots, is_shut=found.is_shut or is_passing)

    def _as_now(self, zone: Zone) -> Zone:
        """The zone, shut if it is cleared, or a door that cannot be used now."""
        is_shut = zone.name in self._cleared or zone.name in self._shut
        return zone if zone.is_shut == is_shut else msgspec.structs.replace(zone, is_shut=is_shut)


def _plain(zone: Zone) -> Zone:
    """A zone of a file as messages have it."""
    return Zone(**msgspec.structs.asdict(zone))
