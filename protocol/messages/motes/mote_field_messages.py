"""How a field of motes is doing, as the coordinator tells it."""

from typing import Annotated

import msgspec
from msgspec import UNSET, Meta, UnsetType

from robrain.protocol.model.ranges import Count, Name, Quantity, Stamp


class ForwarderCount(msgspec.Struct, frozen=True, kw_only=True):
    """A mote that passes on readings of its neighbours."""

    mote: Name
    readings: Count
    """Readings that have arrived for which it was the first to pass them on."""


class GatewayCount(msgspec.Struct, frozen=True, kw_only=True):
    """A gateway between the field and the team's network."""

    name: Name
    readings: Count
    """Readings that have arrived by it."""
    waiting: Count
    """Readings that it stored when it last told one."""
    dropped: Count
    """Readings that it has had no room for."""
    heard_ns: Stamp
    """When it told the last one."""


class MoteFieldState(msgspec.Struct, frozen=True, kw_only=True):
    """How the motes are doing of which the coordinator has ever heard."""

    motes: Count
    """Number of motes."""
    dead: Count
    """Number of those whose cells are empty, as far as can be told."""
    delivery_ratio: Quantity
    """Share of the readings taken since each mote was first heard that have arrived; dead motes count as if they went
    on."""
    age_s: Quantity
    """Mean age of the newest reading of each living mote."""
    oldest_s: Quantity
    """Greatest of these ages."""
    coverage: Quantity
    """Share of the floor between the motes, as far as they can tell of it, of which a mote or a robot in its place does
    tell."""
    on_duty: Count
    """Number of living motes that are on duty."""
    first_dead_ns: Stamp | None = None
    """When the first mote was heard last that is dead."""
    half_dead_ns: Stamp | None = None
    """The same of the mote with which half of them were dead."""
    last_dead_ns: Stamp | None = None
    """The same of the last mote, if all are dead."""
    forwarded: Count | UnsetType = UNSET
    """Readings that have arrived over other motes; absent, as the next two, if there are none."""
    hops: Quantity | UnsetType = UNSET
    """Mean number of motes that have passed such a reading on."""
    forwarders: Annotated[list[ForwarderCount], Meta(max_length=1000)] | UnsetType = UNSET
    """Motes that passed most of them on first, most readings first."""
    gateways: Annotated[list[GatewayCount], Meta(max_length=1000)] | UnsetType = UNSET
    """The gateways, by name; absent if there are none."""

    @property
    def words(self) -> str:
        """The state in one sentence, for people."""
        dead = f", {self.dead} dead" if self.dead else ""
        resting = self.motes - self.dead - self.on_duty
        rest = f", {resting} off duty" if resting > 0 else ""
        return (
            f"{self.motes} motes{dead}{rest}; {100 * self.delivery_ratio:.0f} % of the readings arrived, "
            f"newest {self.age_s:.0f} s old (oldest {self.oldest_s:.0f} s); {100 * self.coverage:.0f} % covered"
            f"{self._path_text}"
        )

    @property
    def _path_text(self) -> str:
        words = ""
        if self.forwarded and self.forwarders and self.hops:
            first = self.forwarders[0]
            words = f"; {self.forwarded} readings passed on, {self.hops:.1f} times each, most by {first.mote}"
        for gateway in self.gateways or ():
            dropped = f", has dropped {gateway.dropped}" if gateway.dropped else ""
            words += f"; gateway {gateway.name} stores {gateway.waiting}{dropped}"
        return words
