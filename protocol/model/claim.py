"""Right of way between robots: each publishes a claim with its path, and both sides compare claims the same way."""

from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.protocol.model.ranges import Length, Name

Degree = Annotated[int, Meta(ge=-1_000_000_000, le=1_000_000_000)]
Rank = tuple[int, int, float, str, int, str]
"""Key by which claims are compared."""


class Claim(msgspec.Struct, frozen=True, kw_only=True):
    """Decides a robot's right of way."""

    cornered: Degree = 0
    """Above 0 if the robot has no place to yield to: one more than the robots that press it. The last to be cornered
    goes first, because the others may have found a refuge by now."""
    priority: Degree = 0
    """Priority of its task; the higher goes first."""
    waited: Degree = 0
    """Counts up while the robot yields. Each count adds one to the priority, so that no robot waits for ever."""
    path_length_m: Length = 0.0
    """Length of its path when it set out; the shorter goes first."""
    lent_by: Name = ""
    """A robot that makes room for another uses that robot's claim, so that others make room in turn. This is priority
    inheritance (Okumura et al., *Priority Inheritance with Backtracking for Iterative Multi-agent Path Finding*, IJCAI
    2019). Empty if the claim is the robot's own."""
    lent: Degree = 0
    """How many robots have passed the claim on."""

    def beats(self, name: str, other: "Claim", other_name: str) -> bool:
        """Whether the robot `name` with this claim goes before another; of any two one does, and never both."""
        return self.rank(name) < other.rank(other_name)

    def lend(self, name: str) -> "Claim":
        """The claim of a robot that makes room for the robot `name`, whose claim this is: next after it."""
        return msgspec.structs.replace(self, lent_by=self.lent_by or name, lent=self.lent + 1)

    def rank(self, name: str) -> Rank:
        """Key for comparisons with the claim of the robot `name`: the lesser goes first."""
        return -self.cornered, -(self.priority + self.waited), self.path_length_m, self.lent_by or name, self.lent, name
