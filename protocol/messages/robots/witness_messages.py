"""Elections of a coordinator by robots, the witnesses.

A team may have several coordinators, each with its own journal. The one that more than half of the witnesses elect
leads. The witnesses also store which journals hold every acknowledged change, and elect no coordinator with another
journal.
"""

from enum import StrEnum
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.ranges import Count, Name, Stamp
from robrain.protocol.topic import Query, Urgency

WITNESSES_MAX = 63
Witnesses = Annotated[list[Name], Meta(max_length=WITNESSES_MAX)]
"""Names of robots."""
Holders = Annotated[list[Name], Meta(max_length=8)]
"""Names of journals, sorted."""


class WitnessWish(StrEnum):
    """Request of a coordinator to a witness."""

    ELECT = "elect"
    """A vote."""
    HOLD = "hold"
    """To store which journals hold every acknowledged change."""


class WitnessRefusal(StrEnum):
    """Why a witness refuses."""

    LEADER_SEEN = "leader_seen"
    """It has received or elected another coordinator within the last 2 s."""
    OUTVOTED = "outvoted"
    """It has voted in this election for another coordinator, or in a later one."""
    LACKS_CHANGES = "lacks_changes"
    """The journal may lack acknowledged changes."""
    UNWRITABLE = "unwritable"
    """It cannot store its answer, and would have forgotten it after a restart."""


class WitnessRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A coordinator's request to a witness."""

    wish: WitnessWish
    """Kind of the request."""
    election: Count
    """Number of the election that is held, or that the coordinator has won; from 1."""
    journal: Name
    """Names the coordinator's journal."""
    began_ns: Stamp = 0
    """Start of the coordinator's process: after a restart it is another candidate."""
    is_copy: bool = False
    """Whether that is a copy of another coordinator's."""
    forced: bool = False
    """An operator confirms that no other journal has more; the witness disregards the stored journals."""
    number: Count = 0
    """Number of a `hold` request; increases within an election."""
    holders: Holders = []
    """Journals that hold every acknowledged change; of a `hold` request."""


class WitnessReply(msgspec.Struct, frozen=True, kw_only=True):
    """A witness's answer."""

    refusal: WitnessRefusal | None = None
    """None if the request is granted."""
    election: Count = 0
    """The greatest number of an election that it has received."""
    before: Name = ""
    """The journal of the last coordinator with another one; empty if there was none."""


class Lead(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A coordinator that was elected."""

    election: Count
    """Number of the election."""
    journal: Name
    """Names its journal."""
    is_suspended: bool = False
    """Whether it offers no task and renews no lease, because another coordinator may have been elected."""
    received: Count = 0
    """Number of witnesses that receive it."""
    witnesses: Witnesses = []
    """All witnesses."""

    @property
    def words(self) -> str:
        """In one line."""
        votes = f"{self.received} of {len(self.witnesses)} witnesses hear it"
        if self.is_suspended:
            return f"the coordinator does not lead: {votes}, and another one may lead"
        return f"the coordinator leads by election {self.election}: {votes}"


class Led(msgspec.Struct, frozen=True, kw_only=True):
    """The last summary that a robot has received from a coordinator that was elected and leads."""

    election: Count
    """Number of the election."""
    stamp_ns: Stamp
    """When that coordinator sent it, by its own clock."""


ROBOT_WITNESS = Query(
    "robot/{robot}/witness",
    "A coordinator asks a robot to elect it, or to remember which journals have all that was acknowledged",
    WitnessRequest, WitnessReply, urgency=Urgency.INTERACTIVE_HIGH)  # fmt: skip
