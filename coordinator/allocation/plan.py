"""What an allocator answers: who does what, when, and with how much energy left."""

import math

import msgspec

from robrain.coordinator.allocation.problem import Objective
from robrain.protocol.wire.reasons.plans import LeftOut


class Stop(msgspec.Struct, frozen=True):
    """One job on a robot's route."""

    job: str
    arrive_s: float
    start_s: float
    end_s: float
    left_j: float
    """What is left of the worker's `usable_j` when the job is done; the way to the charger is still to come."""


class Route(msgspec.Struct, frozen=True):
    """What one robot does. A robot without stops stays where it is and costs nothing."""

    worker: str
    stops: tuple[Stop, ...]
    end_place: int
    """The charger that it goes to; its start if it has no stops."""
    end_s: float
    """When it is there."""
    energy_j: float
    left_j: float
    """What is left of `usable_j` there."""

    @property
    def jobs(self) -> tuple[str, ...]:
        """Ids in the order in which they are done."""
        return tuple(stop.job for stop in self.stops)


class Unassigned(msgspec.Struct, frozen=True):
    """A job that nobody does, and why."""

    job: str
    reason: LeftOut | None = None
    """None until `refusal.reasons` has found it."""


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """Routes of all workers, in the order of the problem's workers."""

    objective: Objective
    routes: tuple[Route, ...]
    unassigned: tuple[Unassigned, ...] = ()
    cost_j: float
    lost_prize_j: float
    makespan_s: float
    """When the last robot that does anything is at its charger; 0 if none does anything."""
    least_left_j: float
    """The least that any robot has left; infinite without robots."""

    @property
    def value(self) -> float:
        """The objective's figure: joules (energy), seconds (makespan), joules (lifetime; the more the better)."""
        if self.objective is Objective.ENERGY:
            return self.cost_j + self.lost_prize_j
        return self.makespan_s if self.objective is Objective.MAKESPAN else self.least_left_j

    @property
    def rank(self) -> tuple[float, float, float]:
        """Of two plans of one problem and objective, that with the lesser rank is the better."""
        match self.objective:
            case Objective.ENERGY:
                return (_coarse(self.cost_j + self.lost_prize_j), self.makespan_s, 0.0)
            case Objective.MAKESPAN:
                return (_coarse(self.lost_prize_j), self.makespan_s, self.cost_j)
            case Objective.LIFETIME:
                return (_coarse(self.lost_prize_j), -self.least_left_j, self.cost_j)

    @property
    def orders(self) -> tuple[tuple[str, ...], ...]:
        """Job ids of each route."""
        return tuple(route.jobs for route in self.routes)


def _coarse(value_j: float) -> float:
    """Rounded to a millijoule, so that the order of summation decides nothing."""
    return round(value_j, 3) if math.isfinite(value_j) else value_j
