"""The table `[links]` of a scenario: links between members on the team's own wire."""

import math
from collections.abc import Iterable
from typing import Annotated

from msgspec import Meta

from robrain.protocol.links.exchange import COORDINATOR
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.ranges import NotNegative, NotNegativeOrInfinite, Positive, PositiveOrInfinite
from robrain.sim.errors import ScenarioError

LOSS_MAX = 0.95
DELAY_MAX_S = 10.0
LOSS_DB_MAX = 200.0


class PartitionSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[[links.partitions]]`: a time in which parts of the team do not receive each other's messages.

    Raises ValueError for a time that ends before it begins, and for a name in two groups.
    """

    from_s: NotNegative = 0.0
    """Simulated time at which it begins."""
    until_s: float | None = None
    """Simulated time at which it ends; absent for the rest of the run."""
    groups: tuple[tuple[str, ...], ...]
    """Robots, gateways beside motes and `coordinator` that still reach each other. Those in no group are one more."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.until_s is not None and not self.until_s > self.from_s:
            raise ValueError(f"expected until_s above from_s, {self.from_s:g}, got {self.until_s:g}")
        names = [name for group in self.groups for name in group]
        if not names or not all(self.groups):
            raise ValueError("expected groups with at least one name each")
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"expected each name in one of the groups, got {name!r} twice")

    def covers(self, sim_time_s: float) -> bool:
        """Whether it is in force."""
        return self.from_s <= sim_time_s < (math.inf if self.until_s is None else self.until_s)

    def group_of(self, party: str) -> int:
        """Number of a party's group; −1 for those in none."""
        return next((number for number, group in enumerate(self.groups) if party in group), -1)


class LinkSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[links]`: the radio between robots and coordinator; without the table, every component receives all messages.

    In lockstep runs only, and only in those that no other process joins. Raises ValueError for impossible values.
    """

    range_m: PositiveOrInfinite = math.inf
    """Distance up to which two radios reach each other with a free line of sight."""
    wall_db: Annotated[float, Meta(ge=0, le=LOSS_DB_MAX)] = 0.0
    """Attenuation of each wall between them."""
    walls_block: bool = False
    """Whether no radio reaches another through a wall."""
    exponent: Positive = 3.0
    """Path-loss exponent, by which walls shorten the range: to `10 ** (-walls * wall_db / (10 * exponent))` of it."""
    loss: Annotated[float, Meta(ge=0, le=LOSS_MAX)] = 0.0
    """Probability that a hop loses a message."""
    delay_s: Annotated[float, Meta(ge=0, le=DELAY_MAX_S)] = 0.0
    """Delay of each hop, besides that of sending."""
    bandwidth_bytes_s: PositiveOrInfinite = math.inf
    """Rate at which each radio sends its own messages and relayed ones, one after the other."""
    queue_s: Positive = 1.0
    """A message that would wait for its radio for longer than this is dropped."""
    relays: bool | tuple[str, ...] = True
    """Members that forward messages of others: all, none, or those with these names (robots, or `coordinator`)."""
    lost_after_s: NotNegative = 2.0
    """Time after which a party counts silent members as absent, as by Zenoh's lease."""
    return_after_s: NotNegativeOrInfinite = 10.0
    """Time after which an idle robot drives back to its start, where others may receive its messages again. `inf` keeps
    it at its place. Robots that do not know their start poses stay.
    """
    coordinator_m: tuple[float, float] | None = None
    """Place of the coordinator's radio, arena frame; that of the first robot's start if absent."""
    partitions: tuple[PartitionSpec, ...] = ()
    """Times in which parts of the team do not receive each other's messages."""

    def check_names(self, robots: Iterable[str], where: str, gateways: Iterable[str] = ()) -> None:
        """Check that there are all robots, and gateways beside motes, that the table names.

        Raises:
            ScenarioError: naming `where`, key and name.

        """
        known, others = [COORDINATOR, *robots], list(gateways)
        named = [("partitions", name) for one in self.partitions for group in one.groups for name in group]
        named += [("relays", name) for name in (() if isinstance(self.relays, bool) else self.relays)]
        for key, name in named:
            if name not in known and name not in others:
                there = f"{COORDINATOR} and r1 to {known[-1]}" + "".join(f", gateway {name}" for name in others)
                raise ScenarioError(f"{where}: links: {key}: no party {name!r}; there are {there}")

    def idle_parameters(self, start: Pose2D) -> dict[str, dict[str, object]]:
        """Parameters of a robot's plugin `idle`, if it returns to its start."""
        if self.return_after_s == math.inf:
            return {}
        return {"idle": {"home": [start.x_m, start.y_m], "return_after_s": self.return_after_s}}

    def reach_m(self, walls: int) -> float:
        """Distance up to which two radios reach each other with this number of walls between them."""
        if walls and self.walls_block:
            return 0.0
        return self.range_m * math.pow(10.0, -walls * self.wall_db / (10.0 * self.exponent))

    def relays_by(self, party: str) -> bool:
        """Whether a party passes on messages of others."""
        return self.relays if isinstance(self.relays, bool) else party in self.relays


def check_alone(links: LinkSpec | None, where: str, *, is_alone: bool) -> None:
    """Check that no other process joins a run with `[links]`: it would be in reach of every component.

    Raises:
        ScenarioError: one may; names `where`.

    """
    if links is not None and not is_alone:
        raise ScenarioError(
            f"{where}: links: expected a run that no other process can join, got one with a dashboard or a port to "
            "listen on: run it without them and look at its recording, or leave [links] out"
        )
