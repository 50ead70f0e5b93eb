"""Standing: a robot's right of way among its mates, as it grows by waiting and by having nowhere to go."""

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.plugins.behavior.encounter import PRESSED_S, Encounter
from robrain.plugins.unit.teammates.interface import Mate
from robrain.protocol.model.navigation.claim import Claim
from robrain.protocol.wire.clock import to_ns

CORNERED_AGAIN_S = 4.0
"""Who has said that it has nowhere to go says so again only after this, chosen: the others need time to make room."""


class Standing:
    """The claim of one robot while it travels.

    Args:
        ageing_s: after waiting so long the claim counts for one more.

    """

    def __init__(self, ageing_s: float) -> None:
        self._ageing_ns = to_ns(ageing_s)
        self._own = Claim()
        self._lent: Claim | None = None
        """The claim of whoever it makes room for."""
        self._held_ns: int | None = None
        self._counted_ns = 0
        self._waited_ns = 0
        self._cornered_ns = -to_ns(CORNERED_AGAIN_S)
        self._cornered_by: list[str] = []
        """The mates that have to give way, because this robot cannot."""

    @property
    def claim(self) -> Claim:
        """What the robot acts by, and tells the team."""
        return self._lent or self._own

    def set_out(self, priority: int, way_m: float) -> None:
        """A new way begins."""
        self._own = Claim(priority=priority, way_m=round(way_m, 1))
        self._lent = None
        self._held_ns = None
        self._waited_ns = 0
        self._cornered_by = []

    def go_on(self) -> None:
        """Nobody holds the robot up."""
        self._held_ns = None

    def wait(self, now_ns: int) -> int:
        """Others hold the robot up; for how long they have at a stretch, nanoseconds."""
        if self._held_ns is None:
            self._held_ns = self._counted_ns = now_ns
        self._waited_ns += now_ns - self._counted_ns
        self._counted_ns = now_ns
        waited = self._waited_ns // self._ageing_ns
        if waited != self._own.waited:
            self._own = msgspec.structs.replace(self._own, waited=waited)
        return now_ns - self._held_ns

    def make_room_for(self, mate: Mate) -> None:
        """Act by that mate's claim, until `take_back`."""
        self._lent = mate.claim.lend(mate.name)

    def take_back(self) -> None:
        """Act by its own claim again."""
        self._lent = None

    def has_no_refuge(self, encounter: Encounter, here: NDArray[np.float64], now_ns: int) -> None:
        """There is nowhere to go; that is told once somebody is near enough to be waiting for it."""
        pressed_by = encounter.in_the_way_of(here, PRESSED_S)
        if pressed_by and now_ns - self._cornered_ns >= to_ns(CORNERED_AGAIN_S):
            self._cornered_ns = now_ns
            self._cornered_by = sorted({*self._cornered_by, *pressed_by})
            most = max(mate.claim.cornered for mate in encounter.mates if mate.name in pressed_by)
            self._own = msgspec.structs.replace(self._own, cornered=1 + most)

    def relieve(self, encounter: Encounter, ahead: NDArray[np.float64]) -> None:
        """Cornered no more, once the ways of those that had to give way do not meet the robot's any longer."""
        if self._cornered_by and not encounter.still_meets(ahead, self._cornered_by):
            self._cornered_by = []
            self._own = msgspec.structs.replace(self._own, cornered=0)
