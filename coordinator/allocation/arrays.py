"""A problem as arrays, which is what the compiled kernels and the solver's model are made from.

A job that needs k robots at once becomes k *visits* of one robot each. A job that a robot is already at becomes no
visit: the robot starts where and when it will have done it, with what is left then. Both are exact.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robrain.coordinator.allocation.problem import Problem
from robrain.protocol.wire.reasons.plans import HolderLacks, HolderLacksEnergy, HolderLate

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


class TeamArrays(NamedTuple):
    """W workers and the n places; as a worker is when it has done what it is pinned to."""

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
    """(W, n) from each place to the charger that takes least energy."""
    end_s: Floats
    horizon_s: float


class VisitArrays(NamedTuple):
    """V visits, each (V,)."""

    job: Indices
    """Index into the problem's jobs."""
    place: Indices
    prize_j: Floats
    """A share of the job's prize, if it takes several."""
    service_s: Floats
    service_j: Floats
    earliest_s: Floats
    latest_s: Floats
    """Latest start."""
    allowed: NDArray[np.bool_]
    """(W, V) the worker has what is needed and may be given the job."""

    def chosen(self, rows: Indices) -> "VisitArrays":
        """Some of them; copies."""
        return VisitArrays(
            self.job[rows],
            self.place[rows],
            self.prize_j[rows],
            self.service_s[rows],
            self.service_j[rows],
            self.earliest_s[rows],
            self.latest_s[rows],
            self.allowed[:, rows],
        )


class ProblemArrays(NamedTuple):
    """Both, and what was taken out of them."""

    team: TeamArrays
    visits: VisitArrays
    pinned: tuple[tuple[int, ...], ...]
    """For each worker the jobs that it is at."""
    refused: dict[int, HolderLacks | HolderLacksEnergy | HolderLate]
    """Jobs that became no visit because their robot cannot finish them, with why."""


def make_arrays(problem: Problem) -> ProblemArrays:
    """Turn structs into arrays."""
    ends = [nearest_ends(problem, worker) for worker in range(len(problem.workers))]
    team = TeamArrays(
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
    )
    pinned, refused = _finish_what_is_running(problem, team)
    running = {index for index, job in enumerate(problem.jobs) if job.pinned_to}
    jobs = [index for index, job in enumerate(problem.jobs) if index not in running for _ in range(job.robots)]
    chosen = [problem.jobs[index] for index in jobs]
    allowed = np.zeros((len(problem.workers), len(jobs)), np.bool_)
    able: dict[tuple[frozenset[str], frozenset[str], bool], NDArray[np.bool_]] = {}
    for column, job in enumerate(chosen):
        kind = (job.needs, job.forbidden_workers, job.ready_only)
        if kind not in able:
            able[kind] = np.array([job.admits(worker) for worker in problem.workers], np.bool_)
        allowed[:, column] = able[kind]
    visits = VisitArrays(
        np.array(jobs, np.int64),
        np.array([job.place for job in chosen], np.int64),
        np.array([job.prize_j / job.robots for job in chosen], np.float64),
        np.array([job.service_s for job in chosen], np.float64),
        np.array([job.service_j for job in chosen], np.float64),
        np.array([job.earliest_s for job in chosen], np.float64),
        np.array([job.latest_s - job.service_s for job in chosen], np.float64),
        allowed,
    )
    return ProblemArrays(team, visits, pinned, refused)


def nearest_ends(problem: Problem, worker_index: int) -> tuple[Floats, Floats, Indices]:
    """Joules, seconds and place of the charger of least energy, from each place; each (n,)."""
    worker = problem.workers[worker_index]
    ends = np.array(sorted(set(worker.ends)), np.int64)
    if len(ends) == 1:
        place = np.full(problem.energy_j.shape[1], ends[0])
        return problem.energy_j[worker.profile, :, ends[0]], problem.time_s[worker.profile, :, ends[0]], place
    energy = problem.energy_j[worker.profile][:, ends]
    best = np.argmin(energy, axis=1)
    rows = np.arange(len(best))
    return energy[rows, best], problem.time_s[worker.profile][rows, ends[best]], ends[best]


def _finish_what_is_running(
    problem: Problem, team: TeamArrays
) -> tuple[tuple[tuple[int, ...], ...], dict[int, HolderLacks | HolderLacksEnergy | HolderLate]]:
    """Move each worker to the end of what it is at; `team` is changed in place."""
    pinned: list[list[int]] = [[] for _ in problem.workers]
    refused: dict[int, HolderLacks | HolderLacksEnergy | HolderLate] = {}
    for index, job in enumerate(problem.jobs):
        if not job.pinned_to:
            continue
        at = problem.worker_index[job.pinned_to]
        way = (team.profile[at], team.start[at], job.place)
        arrive_s = team.ready_s[at] + team.time_s[way]
        start_s = max(arrive_s, job.earliest_s)
        end_s = start_s + job.service_s
        wait_j = team.wait_w[at] * (start_s - arrive_s) if math.isfinite(arrive_s) else 0.0
        left_j = team.usable_j[at] - team.energy_j[way] - wait_j - job.service_j
        if not job.needs <= problem.workers[at].offers:
            refused[index] = HolderLacks(job.pinned_to, tuple(sorted(job.needs)))
        elif end_s > job.latest_s or end_s + team.end_s[at, job.place] > problem.horizon_s:
            refused[index] = HolderLate(job.pinned_to)
        elif not left_j >= team.end_j[at, job.place]:
            refused[index] = HolderLacksEnergy(job.pinned_to)
        else:
            team.start[at], team.ready_s[at], team.usable_j[at] = job.place, end_s, left_j
            pinned[at].append(index)
    return tuple(tuple(jobs) for jobs in pinned), refused
