"""Right of way between robots: each publishes a claim with its path, and both sides compare claims the same way."""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.ranges import Name, Quantity

Degree = Annotated[int, Meta(ge=0, le=1_000_000_000)]
Rank = tuple[int, float, str, int, str]
"""Key by which claims are compared."""
IDLE_S = 1e12
"""`since_s` of a robot without a goal: it yields to all others."""
PRIORITY_S = 20.0
"""A task's priority counts like this much time under way, for each degree."""


class Claim(msgspec.Struct, frozen=True, kw_only=True):
    """Decides a robot's right of way.

    The robot whose travel began first goes first, and at its goal a new travel begins. So each robot has the highest
    priority at some time. This is PIBT (Okumura et al., *Priority Inheritance with Backtracking for Iterative
    Multi-agent Path Finding*, Artificial Intelligence 310, 2022).
    """

    cornered: Degree = 0
    """Above 0 if the robot has no place to yield to: one more than the robots that press it. The last to be cornered
    goes first, because the others may have found a refuge by now."""
    since_s: Quantity = IDLE_S
    """Time at which its travel began, by its own clock, less `PRIORITY_S` for each degree of its task's priority."""
    lent_by: Name = ""
    """The owner of the claim: a robot to which this robot yields, or behind which it drives. Others yield in turn, and
    robots in a line meet others as one. Empty if the claim is the robot's own."""
    lent: Degree = 0
    """How many robots have passed the claim on."""

    def lend(self, name: str) -> "Claim":
        """The claim of a robot that acts by the claim of the robot `name`, which this is: next after it."""
        return msgspec.structs.replace(self, lent_by=self.lent_by or name, lent=self.lent + 1)

    def rank(self, name: str) -> Rank:
        """Key by which the robot `name` with this claim is compared with others: the lesser goes first."""
        return -self.cornered, self.since_s, self.lent_by or name, self.lent, name
