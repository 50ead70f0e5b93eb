"""How the coordinator plans: what is chosen, in one place, and checked where it is built."""

import math
from enum import StrEnum
from typing import Final

import msgspec

from robrain.coordinator.allocation.allocator import ALLOCATORS, OPTIMAL
from robrain.coordinator.exploration.strategies import ASSIGNMENT, STRATEGIES
from robrain.coordinator.planning.plan_passes import PASSES, STOCK_PASSES
from robrain.protocol.model.ranges import Name
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.registry import UnknownEntry

NEAREST: Final = "nearest"
"""The method without a plan: each task goes to the nearest robot that is idle. What plans are compared with."""


class Charging(StrEnum):
    """How robots come to chargers."""

    SCHEDULE = "schedule"
    """Planned ahead."""
    TURNS = "turns"
    """To a charger that is free, when one is; until the battery is full. What the schedule is compared with."""


class PlanningPolicy(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What plans are made for and how. Raises ValueError where it is built with what makes no sense."""

    objective: Objective = Objective.ENERGY
    method: Name = OPTIMAL
    """The allocator that makes the plans, by its name in `ALLOCATORS`; or NEAREST."""
    exploration: Name = ASSIGNMENT
    """Which idle robot is sent to which frontier: the strategy's name in `STRATEGIES`."""
    passes: tuple[Name, ...] = STOCK_PASSES
    """Refinement passes, in their order: their names in `PASSES`."""
    seed: int = 0
    prize_j: float = 1e6
    """What a task of priority 1 is worth; one of priority p is worth p times that. More than any robot's battery
    holds (1 MJ is 278 Wh), so whatever can be done is worth doing, and of two tasks for which there is energy for one
    the one of higher priority is done, if it has at least `capacity / prize_j` more of it."""
    reserve_share: float = 0.1
    """Of its full battery, a robot keeps this when it is back at its charger. Chosen: the robots themselves go home
    with a minute's reserve, and the plan is to be on the careful side of that."""
    confidence: float = 0.95
    """One-sided, of the bounds that a robot's energy is kept by."""
    time_margin: float = 1.1
    """Ways are taken to last so much longer than the robot's usual pace tells: stops to give way, corners."""
    unknown_cost: float = 1.5
    """What a metre of unknown floor counts as. A robot that knows better refuses, and is not asked for a while."""
    gain_min: float = 0.02
    """Tasks change hands only for a plan that is better by this share."""
    settle_s: float = 0.02
    """From one plan to the next at least, so that a burst of news makes one plan (the first makes one at once)."""
    refresh_s: float = 10.0
    """Without any news, a plan is made anew after so long: robots drift off their plans by and by."""
    deadline_s: float = 1.0
    """In live: a plan is searched for so long at the most, and the auction's is there at once."""
    rounds: int = 1
    """Searches for each plan in lockstep."""
    iterations: int = 50
    """Of each search; less where there are many tasks, so that a search stays short."""
    tasks_max: int = 1000
    """In one plan: the most urgent ones."""
    give_up_s: float = 300.0
    """A task that for so long no robot that is there and well could do, by the plan, has failed."""
    charge_below: float = 0.35
    """A robot without tasks goes to charge below this state of charge."""
    charging: Charging = Charging.SCHEDULE
    charge_turn: float = 0.6
    """While tasks wait for energy and a robot with much less waits for the charger, a charge ends here. Chosen: half a
    battery is worth a trip, and above about 0.8 a battery takes less and less."""

    def __post_init__(self) -> None:
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
        for name in ("prize_j", "time_margin", "unknown_cost", "deadline_s", "refresh_s", "give_up_s"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ValueError(f"expected {name} > 0, got {getattr(self, name)}")
        for name in ("reserve_share", "gain_min", "charge_below", "charge_turn"):
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(f"expected {name} from 0 to below 1, got {getattr(self, name)}")
        if not 0.5 <= self.confidence < 1:
            raise ValueError(f"expected confidence from 0.5 to below 1, got {self.confidence}")
        for name in ("settle_s", "seed", "rounds", "iterations"):
            if getattr(self, name) < 0:
                raise ValueError(f"expected {name} >= 0, got {getattr(self, name)}")
        if self.tasks_max < 1:
            raise ValueError(f"expected tasks_max >= 1, got {self.tasks_max}")

    def iterations_for(self, visits: int) -> int:
        """Iterations of one search of so many visits: it stays below some tenths of a second."""
        return max(5, round(self.iterations * min(1.0, 50.0 / max(1, visits))))
