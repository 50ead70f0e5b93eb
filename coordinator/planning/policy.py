"""Parameters of planning, in one place, checked when they are built."""

from pathlib import Path
from typing import Annotated, Final, Literal, Self

import msgspec
from msgspec import Meta

from robrain.algorithms.allocation.allocator import ALLOCATORS, OPTIMAL
from robrain.algorithms.exploration.strategies import AUTO, JOINT, NO_EXPLORATION, STRATEGIES
from robrain.algorithms.exploration.strategies import NEAREST as NEAREST_STRATEGY
from robrain.coordinator.planning.plan_passes import PASSES, STOCK_PASSES
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import NotNegative, NotNegativeInt, Positive, PositiveInt, Text
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.model.zone import ZoneTable, check_zones
from robrain.protocol.registry import IN_FILE, UnknownEntry, absolute_name

NEAREST: Final = "nearest"
"""The method without plans, for comparison: each task goes to the nearest idle robot."""


RENAMED_STRATEGIES: Final = {"assignment": JOINT, "nearest_frontier": NEAREST_STRATEGY}
"""Names that recordings and scenarios of earlier versions have, and those of today."""


class MoteFieldPolicy(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Actions of the coordinator on its own initiative that keep a field of motes alive; by default none.

    Raises ValueError if a value is invalid.
    """

    watch: bool = False
    """Whether to report the state of the field even if no action is taken for it."""
    collect_age_s: NotNegative = 0.0
    """Age of a mote's newest reading at which a robot is to collect; 0: never."""
    collect_timeout_s: Positive = 20.0
    """Longest wait at a mote; at least three of its periods."""
    replacements: NotNegativeInt = 0
    """Number of robots that may stand in for motes at the same time."""
    replacement_s: Positive = 120.0
    """Duration of such a task."""
    replace_before_s: NotNegative = 60.0
    """Time before a mote's predicted end at which a robot may stand in for it."""
    relays: NotNegativeInt = 0
    """Number of robots that may be relays for cut-off motes at the same time."""
    relay_s: Positive = 120.0
    """Duration of such a task."""
    relay_reach_m: Positive = 6.0
    """Distance up to which a relay is expected to receive motes."""
    turns_s: NotNegative = 0.0
    """Period in which motes are put on duty and off duty; 0: all are always on duty."""
    rest_factor: Annotated[float, Meta(ge=1)] = 10.0
    """Off duty, a mote measures once in this number of its periods, but at least every 0.4 `collect_age_s`."""
    sensing_m: Positive = 5.0
    """Distance up to which a mote's reading represents the floor, for duties and coverage."""

    @property
    def is_on(self) -> bool:
        """Whether there is anything to do or to report."""
        return bool(self.watch or self.collect_age_s or self.replacements or self.relays or self.turns_s)


class PlanningPolicy(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Objective and parameters of planning. Raises ValueError if a value is invalid."""

    objective: Objective = Objective.ENERGY
    """Criterion of optimal plans."""
    method: Text = OPTIMAL
    """Name of the allocator that makes the plans: stock, an entry point `robrain.allocators`, or `FILE.py:NAME`;
    `nearest` for none."""
    exploration: Text = AUTO
    """Name of the exploration strategy: stock, an entry point `robrain.exploration_strategies`, or `FILE.py:NAME`;
    `none`: the team explores only if a task tells it to."""
    revise_s: NotNegative = 1.0
    """Period, seconds, in which the exploring robots of a team of two or more may be given another goal. With 0 a robot
    keeps its goal, as a single robot always does."""
    passes: tuple[Text, ...] = STOCK_PASSES
    """Names of the refinement passes, in order: stock, entry points `robrain.plan_passes`, or `FILE.py:NAME`."""
    seed: NotNegativeInt = 0
    """Seed of the searches."""
    prize_j: Positive = 1e6
    """Value of a task of priority 1 in joules; priority p is worth p times that. It is more than a robot's battery
    holds (1 MJ is 278 Wh), so every feasible task is worth doing. If there is energy for only one of two tasks, the one
    of higher priority is done. Its priority must be higher by at least `capacity / prize_j`."""
    delay_w: NotNegative = 10.0
    """Value in joules of each second by which a task of priority 1 ends earlier, for the objective `energy`; priority
    p counts p times that. With 0, few robots do everything if that saves paths, one task after the other."""
    reserve_share: Annotated[float, Meta(ge=0, lt=1)] = 0.1
    """Share of the full battery that must be left when the robot is back at its charger. Chosen to be more careful than
    the robots themselves, which go home with a reserve of one minute."""
    confidence: Annotated[float, Meta(ge=0.5, lt=1)] = 0.95
    """One-sided confidence of the energy bounds."""
    time_margin: Positive = 1.1
    """Factor on travel times beyond the robot's usual pace, for corners and stops to yield."""
    unknown_cost: Positive = 1.5
    """Metres that a metre of unknown floor counts as. A robot may still refuse, and is then not asked for a while."""
    gain_min: Annotated[float, Meta(ge=0, lt=1)] = 0.02
    """Minimum relative improvement for which tasks change robots."""
    settle_s: NotNegative = 0.02
    """Minimum time between plans, so that several changes at once make one plan (the first makes one at once)."""
    refresh_s: Positive = 10.0
    """Time after which a plan is made again without a change, because robots deviate from their plans."""
    deadline_s: Positive = 1.0
    """Time limit of a search in live; the auction's plan is used until then."""
    rounds: NotNegativeInt = 1
    """Searches per plan in lockstep."""
    iterations: NotNegativeInt = 50
    """Iterations per search; reduced for many tasks, to keep a search short."""
    tasks_max: PositiveInt = 1000
    """Limit of tasks in one plan, the most urgent first."""
    give_up_s: Positive = 300.0
    """A task that no present and healthy robot could do for this long, by the plans, has failed."""
    charge_below: Annotated[float, Meta(ge=0, lt=1)] = 0.35
    """A robot without tasks goes to charge below this state of charge."""
    charging: Literal["schedule"] = "schedule"
    """Chargers are scheduled ahead; earlier versions had a second choice, and recordings have this key."""
    charge_turn: Annotated[float, Meta(ge=0, lt=1)] = 0.6
    """Without effect; earlier versions ended a charge at this level, and recordings have this key."""
    mote_field: MoteFieldPolicy = MoteFieldPolicy()
    """Actions of the coordinator on its own initiative that keep a field of motes alive: collect, stand in, relay,
    duties in turn."""
    zones: tuple[ZoneTable, ...] = ()
    """Parts of the floor with rules for robots when the coordinator starts."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_zones(self.zones)
        if self.exploration in RENAMED_STRATEGIES:
            msgspec.structs.force_setattr(self, "exploration", RENAMED_STRATEGIES[self.exploration])
        if self.exploration != NO_EXPLORATION:
            STRATEGIES.check(self.exploration)
        for name in self.passes:
            PASSES.check(name)
        if len(set(self.passes)) < len(self.passes):
            raise ValueError(f"expected each pass once, got {', '.join(self.passes)}")
        if self.method != NEAREST:
            try:
                ALLOCATORS.check(self.method)
            except UnknownEntry as error:
                raise ValueError(f"{error}; {NEAREST} makes no plans") from error

    def with_files_of(self, base: Path) -> Self:
        """The policy with absolute paths for all parts `FILE.py:NAME`; relative ones are relative to `base`."""
        method, exploration, *passes = (
            absolute_name(part, base) for part in (self.method, self.exploration, *self.passes)
        )
        return msgspec.structs.replace(self, method=method, exploration=exploration, passes=tuple(passes))

    def part_files(self) -> list[Path]:
        """The files of its parts `FILE.py:NAME`."""
        parts = (self.method, self.exploration, *self.passes)
        return [Path(found["file"]) for part in parts if (found := IN_FILE.fullmatch(part)) is not None]

    def import_parts(self) -> None:
        """Import the parts that are not robrain's own (UnknownEntry if that fails)."""
        for registry, names in ((STRATEGIES, [self.exploration]), (ALLOCATORS, [self.method]), (PASSES, self.passes)):
            for name in names:
                if not registry.is_stock(name) and name != NEAREST:
                    registry.get(name)

    def iterations_for(self, visits: int) -> int:
        """Iterations of one search for a number of visits, so that it takes less than some tenths of a second."""
        return max(5, round(self.iterations * min(1.0, 50.0 / max(1, visits))))
