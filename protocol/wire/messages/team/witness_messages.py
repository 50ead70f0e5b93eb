"""Who leads: what coordinators ask the robots that are their witnesses, and what both say about it.

Several coordinators may be started for one team, each with a journal of its own. One of them leads: it was elected by
more than half of the witnesses, numbers count the elections. The witnesses also remember which journals have all that
was acknowledged, so that no coordinator with another journal is elected.
"""

from enum import StrEnum
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.ranges import Count, Name, Stamp

WITNESSES_MAX = 63
Witnesses = Annotated[list[Name], Meta(max_length=WITNESSES_MAX)]
"""Names of robots."""
Holders = Annotated[list[Name], Meta(max_length=8)]
"""Names of journals, sorted."""


class WitnessWish(StrEnum):
    """What a coordinator asks a witness for."""

    ELECT = "elect"
    """To elect it."""
    HOLD = "hold"
    """To remember which journals have all that was acknowledged."""


class WitnessRefusal(StrEnum):
    """Why a witness refuses."""

    LEADER_HEARD = "leader_heard"
    """It has heard a coordinator that leads, or elected one, within the last 2 s."""
    OUTVOTED = "outvoted"
    """It has elected another coordinator, with this or a greater number."""
    LACKS_CHANGES = "lacks_changes"
    """The journal may lack what was acknowledged."""
    UNWRITABLE = "unwritable"
    """It cannot store the answer, so that it would have forgotten it after a restart."""


class WitnessRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A coordinator's question to a witness."""

    wish: WitnessWish
    """What it asks for."""
    election: Count
    """Number of the election that is held, or that the coordinator has won; from 1."""
    journal: Name
    """Names the coordinator's journal."""
    began_ns: Stamp = 0
    """When the coordinator's process began to ask, so that one that starts again does not win the same election."""
    is_copy: bool = False
    """Whether that is a copy of another coordinator's."""
    forced: bool = False
    """An operator says that no other journal has more: it is elected whatever the witness remembers."""
    number: Count = 0
    """Of this wish to hold; increases within an election."""
    holders: Holders = []
    """The journals that have all that was acknowledged."""


class WitnessReply(msgspec.Struct, frozen=True, kw_only=True):
    """A witness's answer."""

    refusal: WitnessRefusal | None = None
    """Why not; None if it does as asked."""
    election: Count = 0
    """The greatest number of an election that it knows of."""
    before: Name = ""
    """The journal of the last coordinator with another one; empty if there was none."""


class Lead(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A coordinator that was elected."""

    election: Count
    """Number of the election."""
    journal: Name
    """Names its journal."""
    is_suspended: bool = False
    """Whether it offers nothing and renews no lease, as another coordinator may have been elected."""
    heard: Count = 0
    """Witnesses that hear it, and are heard."""
    witnesses: Witnesses = []
    """All witnesses."""

    @property
    def words(self) -> str:
        """In one line."""
        votes = f"{self.heard} of {len(self.witnesses)} witnesses hear it"
        if self.is_suspended:
            return f"the coordinator does not lead: {votes}, and another one may lead"
        return f"the coordinator leads by election {self.election}: {votes}"


class Led(msgspec.Struct, frozen=True, kw_only=True):
    """The last summary that a robot has heard of a coordinator that was elected and leads."""

    election: Count
    """Number of the election."""
    stamp_ns: Stamp
    """When that coordinator sent it, by its own clock."""
