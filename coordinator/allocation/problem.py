"""What an allocator is asked: jobs, workers, and what the ways between places cost.

Places are rows and columns of the matrices; what they are in the arena is the caller's affair. A job, a worker's start
and a charger each name one. Joules and seconds are floats here; `vrp_model.py` says how they become integers.
"""

import math
from functools import cached_property

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.tasks.objective import Objective as Objective

LARGEST = 1e25
"""Upper bound of joules and of seconds; sums and products of them stay finite."""


class Job(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Something to be done at a place. Raises ValueError where it is built with what makes no sense."""

    id: str
    place: int
    prize_j: float
    """What it is worth, in joules: under `Objective.ENERGY` it is not done where it would cost more."""
    service_s: float = 0.0
    service_j: float = 0.0
    """Energy that each robot at it spends there."""
    earliest_s: float = 0.0
    """It does not start before; a robot that is there earlier waits."""
    latest_s: float = math.inf
    """It must be done (not merely begun) by then."""
    needs: frozenset[str] = frozenset()
    """What a robot must offer."""
    after: tuple[str, ...] = ()
    """Jobs that must have ended before it starts. Ids that the problem does not know count as done."""
    robots: int = 1
    """So many must be at it at once, from its start to its end."""
    pinned_to: str = ""
    """The robot that is already at it: it does it first, and nobody else does."""
    forbidden_workers: frozenset[str] = frozenset()
    """Robots that are not to be given it."""
    ready_only: bool = False
    """Whether only robots that are ready now, with `ready_s` 0, are to be given it."""

    def __post_init__(self) -> None:
        for name in ("prize_j", "service_s", "service_j", "earliest_s"):
            if not 0 <= getattr(self, name) <= LARGEST:
                raise ValueError(f"job {self.id}: expected a finite {name} >= 0, got {getattr(self, name)}")
        if not self.latest_s >= 0:
            raise ValueError(f"job {self.id}: expected latest_s >= 0, got {self.latest_s}")
        if self.robots < 1:
            raise ValueError(f"job {self.id}: expected robots >= 1, got {self.robots}")
        if self.pinned_to and self.robots > 1:
            raise ValueError(
                f"job {self.id}: expected one robot for a job that {self.pinned_to} is at, got {self.robots}"
            )

    def admits(self, worker: "Worker") -> bool:
        """Whether a worker has what the job needs and may be given it."""
        may = worker.name not in self.forbidden_workers and not (self.ready_only and worker.ready_s > 0)
        return may and self.needs <= worker.offers


class Worker(msgspec.Struct, frozen=True, kw_only=True):
    """A robot as it will be when its present task ends. Raises ValueError where it is built with nonsense."""

    name: str
    start: int
    """Place at which it is then."""
    ends: tuple[int, ...]
    """Chargers that it may end at; after its last job it goes to the one that takes the least energy."""
    usable_j: float
    """What it may spend until it is at a charger: the reserve is taken off, and so is what the 95 % bound of the
    estimate asks beyond its mean."""
    offers: frozenset[str] = frozenset()
    ready_s: float = 0.0
    profile: int = 0
    """Which of the problem's matrices are its own."""
    wait_w: float = 0.0
    """What standing draws while it waits between `ready_s` and its end."""
    capacity_j: float = 0.0
    """Its full battery, for words only; 0 if unknown."""
    reserve_j: float = 0.0
    """What was taken off, for words only."""

    def __post_init__(self) -> None:
        if not self.ends:
            raise ValueError(f"worker {self.name}: expected at least one place to end at")
        for name in ("ready_s", "wait_w"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise ValueError(f"worker {self.name}: expected a finite {name} >= 0, got {getattr(self, name)}")
        if not math.isfinite(self.usable_j):
            raise ValueError(f"worker {self.name}: expected a finite usable_j, got {self.usable_j}")


class Problem(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """Jobs, workers and ways. Raises ValueError where it is built with what does not fit together.

    Args:
        jobs: each id once.
        workers: each name once.
        energy_j: (profiles, places, places) joules from a row's place to a column's; infinite where there is no way.
        time_s: the same in seconds.
        horizon_s: by then every robot that does anything is at a charger.

    """

    jobs: tuple[Job, ...]
    workers: tuple[Worker, ...]
    energy_j: NDArray[np.float64]
    time_s: NDArray[np.float64]
    horizon_s: float = math.inf

    def __post_init__(self) -> None:
        shape = self.energy_j.shape
        if len(shape) != 3 or shape[1] != shape[2] or self.time_s.shape != shape:
            raise ValueError(
                f"expected energy_j and time_s of one shape (profiles, places, places), got {shape}"
                f" and {self.time_s.shape}"
            )
        for matrix, name in ((self.energy_j, "energy_j"), (self.time_s, "time_s")):
            if not bool((matrix >= 0).all()):
                raise ValueError(f"expected no {name} below 0 and none that is not a number")
        if len(self.job_index) != len(self.jobs) or len(self.worker_index) != len(self.workers):
            raise ValueError("expected each job id and each worker name once")
        places = range(shape[1])
        for job in self.jobs:
            if job.place not in places:
                raise ValueError(f"job {job.id}: expected a place from 0 to {shape[1] - 1}, got {job.place}")
            if job.pinned_to and job.pinned_to not in self.worker_index:
                raise ValueError(f"job {job.id}: expected pinned_to to be a worker, got {job.pinned_to}")
            if job.pinned_to and self.predecessors(job):
                raise ValueError(f"job {job.id}: {job.pinned_to} is at it, so nothing may have to come before it")
        for worker in self.workers:
            if worker.start not in places or any(end not in places for end in worker.ends):
                raise ValueError(f"worker {worker.name}: expected start and ends from 0 to {shape[1] - 1}")
            if worker.profile not in range(shape[0]):
                raise ValueError(f"worker {worker.name}: expected a profile from 0 to {shape[0] - 1}")

    @cached_property
    def job_index(self) -> dict[str, int]:
        """Where a job stands in `jobs`."""
        return {job.id: index for index, job in enumerate(self.jobs)}

    @cached_property
    def worker_index(self) -> dict[str, int]:
        """Where a worker stands in `workers`."""
        return {worker.name: index for index, worker in enumerate(self.workers)}

    def predecessors(self, job: Job) -> list[str]:
        """The jobs of the problem that must end before this one starts."""
        return [other for other in job.after if other in self.job_index]
