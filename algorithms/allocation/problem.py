"""The input of an allocator: jobs, workers, and the cost of paths between places; and its arrays.

A place is an index into the matrices; the caller maps it to the arena. Each job, worker start and charger has one.
Joules and seconds are floats here; `vrp_model.py` describes their conversion to integers.

`make_arrays` converts a problem to arrays, the input of the compiled kernels and of the PyVRP model. A job for k robots
becomes k *visits* of one robot each. A job that a robot is already doing becomes no visit. The robot then starts at the
place, time and energy at which it will have finished that job. Both conversions are exact.
"""

import math
from functools import cached_property
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.tasks.objective import Objective as Objective
from robrain.protocol.reasons import HolderLacksEnergy, PlainReason, plain

LARGEST = 1e25
"""Upper bound of joules and of seconds; sums and products of them stay finite."""
LARGEST_KG = 1e6
SLACK_KG = 1e-6
"""Tolerance for sums of loads."""


class Job(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Work to be done at a place. Raises ValueError if its values are invalid."""

    id: str
    place: int
    prize_j: float
    """Value in joules: under `Objective.ENERGY` the job stays unassigned if it would cost more."""
    delay_w: float = 0.0
    """Joules that each second from `earliest_s` to its end counts for under `Objective.ENERGY`."""
    service_s: float = 0.0
    service_j: float = 0.0
    """Energy that each of its robots spends at the place."""
    end_place: int | None = None
    """Place where the job ends, if it is another one; the next path begins there. `service_s` and `service_j` include
    the path from `place` to it."""
    earliest_s: float = 0.0
    """Earliest start; a robot that arrives earlier waits."""
    latest_s: float = math.inf
    """Latest end, not only start."""
    needs: frozenset[str] = frozenset()
    """Plugins that the robot must offer."""
    after: tuple[str, ...] = ()
    """Jobs that must have ended before it starts. Unknown ids count as done."""
    robots: int = 1
    """Number of robots that work on it together, from its start to its end."""
    pinned_to: str = ""
    """The robot that is already doing it: this robot does it first, and no other does."""
    forbidden_workers: frozenset[str] = frozenset()
    """Robots that must not get it."""
    load_kg: float = 0.0
    """Change of its robot's load: above 0 for a pickup, below 0 for a delivery."""
    same_worker_as: str = ""
    """The job that one and the same robot does before it, such as the pickup of a delivery. It is one of `after`, and
    a robot does both or neither. An unknown id has no effect."""

    def __post_init__(self) -> None:
        for name in ("prize_j", "delay_w", "service_s", "service_j", "earliest_s"):
            if not 0 <= getattr(self, name) <= LARGEST:
                raise ValueError(f"job {self.id}: expected a finite {name} >= 0, got {getattr(self, name)}")
        if not self.latest_s >= 0:
            raise ValueError(f"job {self.id}: expected latest_s >= 0, got {self.latest_s}")
        if not abs(self.load_kg) <= LARGEST_KG:
            raise ValueError(f"job {self.id}: expected load_kg of at most {LARGEST_KG:g}, got {self.load_kg}")
        if self.robots > 1 and (self.load_kg or self.same_worker_as):
            raise ValueError(f"job {self.id}: expected one robot for a job with a load or a pickup, got {self.robots}")
        if self.same_worker_as and self.same_worker_as not in self.after:
            raise ValueError(f"job {self.id}: expected {self.same_worker_as} in `after`, as in same_worker_as")
        if self.robots < 1:
            raise ValueError(f"job {self.id}: expected robots >= 1, got {self.robots}")
        if self.pinned_to and self.robots > 1:
            raise ValueError(
                f"job {self.id}: expected one robot for a job that {self.pinned_to} is at, got {self.robots}"
            )

    @property
    def exit_place(self) -> int:
        """Place where its robots are at its end."""
        return self.place if self.end_place is None else self.end_place

    def admits(self, worker: "Worker") -> bool:
        """Whether the worker offers what the job needs and is not excluded."""
        return worker.name not in self.forbidden_workers and self.needs <= worker.offers


class Worker(msgspec.Struct, frozen=True, kw_only=True):
    """A robot as it will be after its present task. Raises ValueError if its values are invalid."""

    name: str
    start: int
    """Place where it is then."""
    ends: tuple[int, ...]
    """Chargers at which its route may end; it takes the one that is cheapest in energy."""
    usable_j: float
    """Energy that the robot may spend until it is at a charger. It excludes the reserve, and the margin between the
    mean and the 95 % bound of the estimate."""
    offers: frozenset[str] = frozenset()
    ready_s: float = 0.0
    profile: int = 0
    """Index of its matrices."""
    wait_w: float = 0.0
    """Power while it waits, from `ready_s` to its end."""
    capacity_j: float = 0.0
    """Full battery, for explanations only; 0 if unknown."""
    reserve_j: float = 0.0
    """Deducted reserve, for explanations only."""
    capacity_kg: float = math.inf
    """Greatest load."""
    load_kg: float = 0.0
    """Load at the start."""
    chargers: tuple[int, ...] = ()
    """Places where it may charge between two jobs, always to `full_j`; empty if it charges only at the end."""
    full_j: float = 0.0
    """As `usable_j`, after a charge."""
    charge_w: float = 0.0
    """Power of a charge."""

    def __post_init__(self) -> None:
        if not self.ends:
            raise ValueError(f"worker {self.name}: expected at least one place to end at")
        for name in ("ready_s", "wait_w"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise ValueError(f"worker {self.name}: expected a finite {name} >= 0, got {getattr(self, name)}")
        if not (0 <= self.load_kg <= LARGEST_KG and self.capacity_kg >= self.load_kg):
            raise ValueError(
                f"worker {self.name}: expected a load_kg from 0 to its capacity, {self.capacity_kg}, got {self.load_kg}"
            )
        if not math.isfinite(self.usable_j):
            raise ValueError(f"worker {self.name}: expected a finite usable_j, got {self.usable_j}")
        if self.chargers and not (0 < self.full_j <= LARGEST and 0 < self.charge_w <= LARGEST):
            raise ValueError(
                f"worker {self.name}: expected a full_j and a charge_w > 0, as it has chargers, got {self.full_j}"
                f" and {self.charge_w}"
            )


class Problem(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """Jobs, workers and paths. Raises ValueError if they are inconsistent.

    Args:
        jobs: with unique ids.
        workers: with unique names.
        energy_j: (profiles, places, places) joules from a row's place to a column's; infinite where there is no path.
        time_s: the same in seconds.
        horizon_s: every robot with a job must be at a charger by then.
        length_m: (profiles, places, places) lengths of the paths, for explanations only; None if they are unknown.

    """

    jobs: tuple[Job, ...]
    workers: tuple[Worker, ...]
    energy_j: NDArray[np.float64]
    time_s: NDArray[np.float64]
    horizon_s: float = math.inf
    length_m: NDArray[np.float64] | None = None

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
            for place in (job.place, job.exit_place):
                if place not in places:
                    raise ValueError(f"job {job.id}: expected a place from 0 to {shape[1] - 1}, got {place}")
            if job.pinned_to and job.pinned_to not in self.worker_index:
                raise ValueError(f"job {job.id}: expected pinned_to to be a worker, got {job.pinned_to}")
            if job.pinned_to and self.predecessors(job):
                raise ValueError(f"job {job.id}: {job.pinned_to} is at it, so nothing may have to come before it")
        pickups = [self.pickup(job) for job in self.jobs if self.pickup(job)]
        if len(set(pickups)) != len(pickups) or any(self.pickup(self.jobs[self.job_index[name]]) for name in pickups):
            raise ValueError("expected each job in one pair of same_worker_as at most")
        for worker in self.workers:
            if any(place not in places for place in (worker.start, *worker.ends, *worker.chargers)):
                raise ValueError(f"worker {worker.name}: expected start, ends and chargers from 0 to {shape[1] - 1}")
            if worker.profile not in range(shape[0]):
                raise ValueError(f"worker {worker.name}: expected a profile from 0 to {shape[0] - 1}")

    @cached_property
    def job_index(self) -> dict[str, int]:
        """Index of each job in `jobs`."""
        return {job.id: index for index, job in enumerate(self.jobs)}

    @cached_property
    def worker_index(self) -> dict[str, int]:
        """Index of each worker in `workers`."""
        return {worker.name: index for index, worker in enumerate(self.workers)}

    @cached_property
    def coupled(self) -> dict[int, list[int]]:
        """Jobs that wait for others, are waited for or need several robots, each with those that wait for it.

        A delivery's wait for its pickup does not count. If one of the two is coupled to other jobs, both are.
        """
        waiting: dict[int, list[int]] = {}
        for index, job in enumerate(self.jobs):
            before = [other for other in self.predecessors(job) if self.deliveries.get(self.job_index[other]) != index]
            if before or job.robots > 1:
                waiting.setdefault(index, [])
            for other in before:
                waiting.setdefault(self.job_index[other], []).append(index)
        for pickup, delivery in self.deliveries.items():
            if pickup in waiting or delivery in waiting:
                waiting.setdefault(pickup, [])
                waiting.setdefault(delivery, [])
        return waiting

    @cached_property
    def deliveries(self) -> dict[int, int]:
        """Indices of the pickups that no robot has begun, each with its delivery."""
        pickups = {self.job_index[name]: index for index, job in enumerate(self.jobs) if (name := self.pickup(job))}
        return {pickup: delivery for pickup, delivery in pickups.items() if not self.jobs[pickup].pinned_to}

    def pickup(self, job: Job) -> str:
        """The job of the problem that the same robot must do before this one; empty if there is none."""
        return job.same_worker_as if job.same_worker_as in self.job_index else ""

    def predecessors(self, job: Job) -> list[str]:
        """The jobs of the problem that must end before this one starts."""
        return [other for other in job.after if other in self.job_index]


Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


class TeamArrays(NamedTuple):
    """W workers and n places; each worker is in the state that it has after its pinned jobs."""

    energy_j: Floats
    """(profiles, n, n)"""
    time_s: Floats
    profile: Indices
    """(W,)"""
    start: Indices
    ready_s: Floats
    usable_j: Floats
    wait_w: Floats
    end_j: Floats
    """(W, n) joules from each place to the charger that is cheapest in energy."""
    end_s: Floats
    horizon_s: float
    capacity_kg: Floats
    """(W,)"""
    load_kg: Floats
    """At the start."""
    charger: Indices
    """(C,) places where some worker may charge between visits."""
    charges: NDArray[np.bool_]
    """(W, C) whether the worker may charge there."""
    full_j: Floats
    """(W,) usable joules after a charge."""
    charge_w: Floats
    """(W,) power of a charge; 0 without chargers."""


class VisitArrays(NamedTuple):
    """V visits, each (V,)."""

    job: Indices
    """Index into the problem's jobs."""
    delivery: Indices
    """The visit that the same worker must make after this one; −1 if there is none."""
    pickup: Indices
    """The visit that the same worker must make before this one; −1 if there is none."""
    load_kg: Floats
    place: Indices
    exit_place: Indices
    """Where the worker is at the end of the visit."""
    prize_j: Floats
    """The job's prize, divided among its visits; that of a delivery belongs to its pickup."""
    delay_w: Floats
    """The job's, divided likewise."""
    service_s: Floats
    service_j: Floats
    earliest_s: Floats
    latest_s: Floats
    """Latest start."""
    allowed: NDArray[np.bool_]
    """(W, V) whether the worker has what the job needs and is admitted to it."""

    def chosen(self, rows: Indices) -> "VisitArrays":
        """Select some visits, of a pair both or none; returns copies."""
        row_of = np.full(len(self.job) + 1, -1, np.int64)
        row_of[rows] = np.arange(len(rows))
        return VisitArrays(
            self.job[rows],
            row_of[self.delivery[rows]],
            row_of[self.pickup[rows]],
            self.load_kg[rows],
            self.place[rows],
            self.exit_place[rows],
            self.prize_j[rows],
            self.delay_w[rows],
            self.service_s[rows],
            self.service_j[rows],
            self.earliest_s[rows],
            self.latest_s[rows],
            np.ascontiguousarray(self.allowed[:, rows]),  # another layout would compile the kernels again
        )


class ProblemArrays(NamedTuple):
    """Team and visits, and the jobs and workers removed from them."""

    team: TeamArrays
    visits: VisitArrays
    pinned: tuple[tuple[int, ...], ...]
    """For each worker, the jobs that it is doing."""
    refused: dict[int, HolderLacksEnergy | PlainReason]
    """Jobs without a visit because their robot cannot finish them, with the reason."""


def make_arrays(problem: Problem) -> ProblemArrays:
    """Convert the structs to arrays."""
    team = team_arrays(problem)
    pinned, refused = _finish_running(problem, team)
    running = {index for index, job in enumerate(problem.jobs) if job.pinned_to}
    jobs = [index for index, job in enumerate(problem.jobs) if index not in running for _ in range(job.robots)]
    chosen = [problem.jobs[index] for index in jobs]
    allowed = np.zeros((len(problem.workers), len(jobs)), np.bool_)
    able: dict[tuple[frozenset[str], frozenset[str]], NDArray[np.bool_]] = {}
    for column, job in enumerate(chosen):
        kind = (job.needs, job.forbidden_workers)
        if kind not in able:
            able[kind] = np.array([job.admits(worker) for worker in problem.workers], np.bool_)
        allowed[:, column] = able[kind]
    row_of = {index: row for row, index in enumerate(jobs)}
    delivery, pickup = np.full(len(jobs), -1, np.int64), np.full(len(jobs), -1, np.int64)
    for first, second in problem.deliveries.items():
        delivery[row_of[first]], pickup[row_of[second]] = row_of[second], row_of[first]
        allowed[:, row_of[first]] &= allowed[:, row_of[second]]
        allowed[:, row_of[second]] = allowed[:, row_of[first]]
    load_kg = np.array([job.load_kg for job in chosen], np.float64)
    for column, job in enumerate(chosen):
        if pickup[column] < 0 and job.load_kg < 0:
            allowed[:, column] &= team.load_kg >= -job.load_kg - SLACK_KG
        holder = problem.jobs[problem.job_index[name]].pinned_to if (name := problem.pickup(job)) else ""
        if holder:
            allowed[:, column] &= np.array([worker.name == holder for worker in problem.workers], np.bool_)
    prize_j = np.array([job.prize_j / job.robots for job in chosen], np.float64)
    prize_j[delivery >= 0] += prize_j[delivery[delivery >= 0]]
    prize_j[pickup >= 0] = 0.0
    visits = VisitArrays(
        np.array(jobs, np.int64),
        delivery,
        pickup,
        load_kg,
        np.array([job.place for job in chosen], np.int64),
        np.array([job.exit_place for job in chosen], np.int64),
        prize_j,
        np.array([job.delay_w / job.robots for job in chosen], np.float64),
        np.array([job.service_s for job in chosen], np.float64),
        np.array([job.service_j for job in chosen], np.float64),
        np.array([job.earliest_s for job in chosen], np.float64),
        np.array([job.latest_s - job.service_s for job in chosen], np.float64),
        allowed,
    )
    return ProblemArrays(team, visits, pinned, refused)


def team_arrays(problem: Problem) -> TeamArrays:
    """Convert the workers to arrays, in the state before their pinned jobs."""
    ends = [nearest_ends(problem, worker) for worker in range(len(problem.workers))]
    chargers = sorted({place for worker in problem.workers for place in worker.chargers})
    return TeamArrays(
        np.ascontiguousarray(problem.energy_j, np.float64),
        np.ascontiguousarray(problem.time_s, np.float64),
        np.array([worker.profile for worker in problem.workers], np.int64),
        np.array([worker.start for worker in problem.workers], np.int64),
        np.array([worker.ready_s for worker in problem.workers], np.float64),
        np.array([worker.usable_j for worker in problem.workers], np.float64),
        np.array([worker.wait_w for worker in problem.workers], np.float64),
        np.array([energy for energy, _, _ in ends]).reshape(len(ends), problem.energy_j.shape[1]),
        np.array([time for _, time, _ in ends]).reshape(len(ends), problem.energy_j.shape[1]),
        float(problem.horizon_s),
        np.array([worker.capacity_kg for worker in problem.workers], np.float64),
        np.array([worker.load_kg for worker in problem.workers], np.float64),
        np.array(chargers, np.int64),
        np.array([[place in worker.chargers for place in chargers] for worker in problem.workers], np.bool_).reshape(
            len(problem.workers), len(chargers)
        ),
        np.array([worker.full_j for worker in problem.workers], np.float64),
        np.array([worker.charge_w if worker.chargers else 0.0 for worker in problem.workers], np.float64),
    )


def nearest_ends(problem: Problem, worker_index: int) -> tuple[Floats, Floats, Indices]:
    """Joules, seconds and place of the charger that is cheapest in energy, from each place; each (n,)."""
    worker = problem.workers[worker_index]
    ends = np.array(sorted(set(worker.ends)), np.int64)
    if len(ends) == 1:
        place = np.full(problem.energy_j.shape[1], ends[0])
        return problem.energy_j[worker.profile, :, ends[0]], problem.time_s[worker.profile, :, ends[0]], place
    energy = problem.energy_j[worker.profile][:, ends]
    best = np.argmin(energy, axis=1)
    rows = np.arange(len(best))
    return energy[rows, best], problem.time_s[worker.profile][rows, ends[best]], ends[best]


def _finish_running(
    problem: Problem, team: TeamArrays
) -> tuple[tuple[tuple[int, ...], ...], dict[int, HolderLacksEnergy | PlainReason]]:
    """Advance each worker to the end of its pinned jobs; changes `team` in place."""
    pinned: list[list[int]] = [[] for _ in problem.workers]
    refused: dict[int, HolderLacksEnergy | PlainReason] = {}
    for index, job in enumerate(problem.jobs):
        if not job.pinned_to:
            continue
        at = problem.worker_index[job.pinned_to]
        leg = (team.profile[at], team.start[at], job.place)
        arrive_s = team.ready_s[at] + team.time_s[leg]
        start_s = max(arrive_s, job.earliest_s)
        end_s = start_s + job.service_s
        wait_j = team.wait_w[at] * (start_s - arrive_s) if math.isfinite(arrive_s) else 0.0
        left_j = team.usable_j[at] - team.energy_j[leg] - wait_j - job.service_j
        if not job.needs <= problem.workers[at].offers:
            needs = tuple(sorted(job.needs))
            text = f"{job.pinned_to} is at it and lacks {', '.join(needs)}"
            refused[index] = plain("holder_lacks", text, robot=job.pinned_to, plugins=needs)
        elif end_s > job.latest_s or end_s + team.end_s[at, job.exit_place] > problem.horizon_s:
            text = f"{job.pinned_to} is at it and cannot end it in time"
            refused[index] = plain("holder_late", text, robot=job.pinned_to)
        elif not -SLACK_KG <= team.load_kg[at] + job.load_kg <= team.capacity_kg[at] + SLACK_KG:
            text = f"{job.pinned_to} is at it and cannot carry that"
            refused[index] = plain("holder_full", text, robot=job.pinned_to)
        elif not left_j >= team.end_j[at, job.exit_place]:
            refused[index] = HolderLacksEnergy(job.pinned_to)
        else:
            team.start[at], team.ready_s[at], team.usable_j[at] = job.exit_place, end_s, left_j
            team.load_kg[at] += job.load_kg
            pinned[at].append(index)
    return tuple(tuple(jobs) for jobs in pinned), refused
