"""Right of way between robots: each publishes a claim with its path, and both sides compare claims the same way."""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.ranges import Name, Quantity, Stamp

Degree = Annotated[int, Meta(ge=0, le=1_000_000_000)]
Rank = tuple[int, float, str, int, str]
"""Key by which claims are compared."""
IDLE_S = 1e12
"""`order_s` of a robot without a goal: it yields to all others."""
FOLLOWS = 1000
"""Added to `lent` of a robot that drives behind another: more than robots pass on a claim to make room."""
PRIORITY_S = 20.0
"""A task's priority counts like this much time under way, for each degree."""
LEFT_WEIGHT = 2.0
"""Each second that a travel still needs counts like this much time under way less (chosen: decision 0076)."""


class Claim(msgspec.Struct, frozen=True, kw_only=True):
    """Decides a robot's right of way.

    A robot that set out earlier, or is nearer to its goal, goes first, and at its goal a new travel begins. So each
    robot has the highest priority at some time. This is as in PIBT (Okumura et al., *Priority Inheritance with
    Backtracking for Iterative Multi-agent Path Finding*, Artificial Intelligence 310, 2022).
    """

    cornered: Degree = 0
    """Above 0 if the robot has no place to yield to: one more than the robots that press it. The last to be cornered
    goes first, because the others may have found a refuge by now."""
    order_s: Quantity = IDLE_S
    """Time at which its travel began, by its own clock, plus `LEFT_WEIGHT` times the time that it still needs. Each
    degree of its task's priority takes `PRIORITY_S` off. The lesser goes first."""
    lent_by: Name = ""
    """The owner of the claim: a robot to which this robot yields, or behind which it drives. Others yield in turn, and
    robots in a line meet others as one. Empty if the claim is the robot's own."""
    lent: Degree = 0
    """How many robots have passed the claim on."""

    def lend(self, name: str, *, to_follower: bool = False) -> "Claim":
        """The claim of a robot that makes room for the robot `name`, which has this claim, or follows it.

        Robots that make room go before those that follow, as otherwise they might have no place to go to.
        """
        lent = self.lent + (FOLLOWS if to_follower else 1)
        return msgspec.structs.replace(self, lent_by=self.lent_by or name, lent=lent)

    def rank(self, name: str) -> Rank:
        """Key by which the robot `name` with this claim is compared with others: the lesser goes first."""
        return -self.cornered, self.order_s, self.lent_by or name, self.lent, name


ZoneNames = Annotated[tuple[Name, ...], Meta(max_length=256)]


class Reservation(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A robot's request for zones that its path crosses."""

    robot: Name
    zones: ZoneNames
    """Names of the zones, which are reserved together."""
    since_ns: Stamp
    """Time of the request, by the robot's clock: the earlier request goes first. It also identifies the request."""
    has: bool = False
    """Whether the robot may drive there, or is there."""

    @property
    def rank(self) -> tuple[int, str]:
        """Key by which requests are compared: the lesser goes first."""
        return self.since_ns, self.robot
