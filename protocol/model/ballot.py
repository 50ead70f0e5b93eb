"""Messages between robots that allocate tasks: the winning bids that each knows, and how fresh that is."""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.ranges import Count, Name

TASKS_MAX = 256
"""Tasks that are allocated at a time (chosen; 256 bids are about 12 kB)."""
ROBOTS_MAX = 128
"""Robots that take part at a time (chosen)."""
Value = Annotated[float, Meta(ge=-1e15, le=1e15)]
Score = Annotated[float, Meta(ge=0.0, le=1e15)]


class Bid(msgspec.Struct, frozen=True, kw_only=True):
    """The best bid for a task that a robot has received."""

    task: Name
    """Id of the task."""
    robot: Name
    """Robot that made it."""
    score: Score
    """Value of the task to that robot, in joules."""

    def beats(self, other: "Bid | None") -> bool:
        """Whether it wins against another bid for the task: the greater score; of equal ones the lesser name."""
        return other is None or (-self.score, self.robot) < (-other.score, other.robot)


Bids = Annotated[tuple[Bid, ...], Meta(max_length=TASKS_MAX)]


class SeenBallot(msgspec.Struct, frozen=True, kw_only=True):
    """A robot's knowledge of another."""

    robot: Name
    """The other robot."""
    number: Count
    """Of its last ballot that is taken into account, directly or by others."""


SeenBallots = Annotated[tuple[SeenBallot, ...], Meta(max_length=ROBOTS_MAX)]


class BidProgress(msgspec.Struct, frozen=True, kw_only=True):
    """How far a robot has come in a round of the negotiation."""

    robot: Name
    """Robot that it describes."""
    number: Count
    """Number of the robot's ballot that reported it."""
    round: Count
    """Round of the negotiation."""
    digest: Count
    """Of all winners as the robot knows them, and of the round; see `digest_of`."""
    value: Value
    """Value that the robot assigns to its path."""


Standings = Annotated[tuple[BidProgress, ...], Meta(max_length=ROBOTS_MAX)]


class Ballot(msgspec.Struct, frozen=True, kw_only=True):
    """A robot's whole knowledge of the bidding. A later one replaces an earlier one of the same robot."""

    robot: Name
    """Name of the sender."""
    number: Count
    """Greater than in every earlier ballot of this robot."""
    bids: Bids = ()
    """At most one for each task, sorted by task."""
    received: SeenBallots = ()
    """Each other robot that this one has received."""
    term: Count = 0
    """Number of the negotiation; ballots of an earlier one are out of date."""
    round: Count = 0
    """Round of the negotiation: 0 is the first allocation, each later one tries an improvement."""
    base: Count = 0
    """Digest of the allocation that the round starts from."""
    base_value: Value = 0.0
    """Value of that allocation, all paths together."""
    standings: Standings = ()
    """The last known ones of all robots, its own included."""
