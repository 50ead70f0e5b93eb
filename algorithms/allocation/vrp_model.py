"""A problem as a PyVRP model: visits are clients, workers are vehicle types, energy is distance.

Each worker is a vehicle type of one vehicle with its own start, end, profile and maximum distance. Equal workers
are one type of several vehicles. Distances are joules and durations are seconds, both as integers:
a median path has `J_UNITS` and `S_UNITS`.

Energy is rounded to the safe side: paths up, budgets down. A solution that is feasible in PyVRP is feasible in joules.
A plan at its exact limit may be missed, by 1e-4 of a median path per stop. Times are rounded down, so that a plan's own
times are never infeasible. The error is 1e-7 of a median path per stop. This is within the slack of `validate`, which
every plan passes in the end.

The largest values are bounded: a budget is at most the sum of all paths. A missing path is one unit longer than the
largest budget. Penalties are at most `MAX_PENALTY` per unit. With 1,000 visits that is 1e8 · 1e5 for a distance and
1e11 · 1e5 for a time, far below 2^63.

Chargers are resolved beforehand: one end for each set of chargers, whose matrix column is the path to the nearest one.

A visit that a worker must not make is a missing path, in separate matrices for each kind of worker. If the matrices
would need too much memory, each need is a load of one unit in its own dimension. Workers that offer it have capacity
for all visits, other workers have none. Missing paths were better by 1.5 % at 20 × 200 after equal iterations (three
seeds, 40 % of the jobs with a need). At 60 × 600 there was no difference.

A pickup and its delivery are a shipment. Other jobs with a load are clients with a pickup or a delivery. Loads are
whole grams, rounded up; capacities are rounded down.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pyvrp import Activity, ActivityType, Client, Depot, Location, ProblemData, Route, Shipment, Solution, VehicleType

from robrain.algorithms.allocation.problem import Floats, Indices, Objective, Problem, ProblemArrays, VisitArrays

J_UNITS = 1e4
"""Units of a median path including the service at its end; chosen so that rounding costs about 1e-4."""
S_UNITS = 1e7
KG_UNITS = 1000
MAX_PENALTY = 100_000.0
PRIZE_LIMIT = 2.0**50
Matrix = np.ndarray[Any, np.dtype[np.int64]]
MOST_CELLS = 1e7
"""Limit for all distance matrices together, 80 MB; beyond, needs become loads."""
FOREVER = 2**44
"""A time beyond every schedule, in units."""

ROUNDING = 1e-6
"""A float this far above an integer, in units, counts as that integer."""


class _Load(NamedTuple):
    """A constraint as a load dimension: its jobs load one unit, and its workers have capacity for them."""

    jobs: frozenset[str]
    workers: frozenset[int]


def _loads(problem: Problem) -> list[_Load]:
    jobs, workers = problem.jobs, list(enumerate(problem.workers))
    loads = [
        _Load(
            frozenset(job.id for job in jobs if need in job.needs),
            frozenset(index for index, worker in workers if need in worker.offers),
        )
        for need in sorted({need for job in jobs for need in job.needs})
    ]
    for names in sorted({tuple(sorted(job.forbidden_workers)) for job in jobs if job.forbidden_workers}):
        forbidding = frozenset(job.id for job in jobs if job.forbidden_workers == set(names))
        loads.append(_Load(forbidding, frozenset(index for index, worker in workers if worker.name not in names)))
    return loads


class VrpModel:
    """One problem; its limits can be tightened without rebuilding the matrices.

    Args:
        problem: the problem.
        arrays: of the problem.
        visits: those of the arrays, possibly with narrower windows (see `coupling.py`).
        required: (V,) visits that must be made.
        objective: unless it is energy, prizes outweigh paths.

    """

    def __init__(
        self,
        problem: Problem,
        arrays: ProblemArrays,
        visits: VisitArrays,
        required: NDArray[np.bool_],
        objective: Objective,
    ) -> None:
        self._problem, self._visits, self._objective = problem, visits, objective
        self._team, self._load_kg = arrays.team, visits.load_kg
        self._count = len(visits.job)
        equal: dict[tuple[object, ...], list[int]] = {}
        for index, worker in enumerate(problem.workers):
            if arrays.team.usable_j[index] >= 0:
                state = (float(each[index]) for each in (arrays.team.start, arrays.team.ready_s, arrays.team.usable_j))
                limits = worker.capacity_kg, float(arrays.team.load_kg[index]), visits.allowed[index].tobytes()
                equal.setdefault((worker.profile, worker.ends, *state, *limits), []).append(index)
        self._equal = list(equal.values())
        """Indices of the workers of each vehicle type."""
        self._workers = [workers[0] for workers in self._equal]
        rows = [(int(arrays.team.profile[worker]), visits.allowed[worker].tobytes()) for worker in self._workers]
        kinds = sorted(set(rows))
        is_by_routes = len(kinds) * (self._count + len(self._workers)) ** 2 <= MOST_CELLS
        self._loads = [] if is_by_routes else _loads(problem)
        if not is_by_routes:
            rows = [(profile, b"") for profile, _ in rows]
            kinds = sorted(set(rows))
        self._kind_of = dict(zip(self._workers, map(kinds.index, rows), strict=True))
        self._end_sets = sorted({(int(arrays.team.profile[w]), *problem.workers[w].ends) for w in self._workers})
        self._end_of = [self._end_index(problem, worker) for worker in range(len(problem.workers))]
        self._units_per_j, self._units_per_s = self._scales(visits)
        self._budgets = self._budget_units(visits)
        energy, time = self._matrices(visits)
        self._singles = np.flatnonzero((visits.delivery < 0) & (visits.pickup < 0)).tolist()
        self._pairs = [(int(row), int(visits.delivery[row])) for row in np.flatnonzero(visits.delivery >= 0)]
        self._activities = {visit: Activity(ActivityType.CLIENT, index) for index, visit in enumerate(self._singles)}
        for index, (pickup, delivery) in enumerate(self._pairs):
            self._activities[pickup] = Activity(ActivityType.PICKUP, index)
            self._activities[delivery] = Activity(ActivityType.DELIVERY, index)
        self._visit_of = {(one.type, one.idx): visit for visit, one in self._activities.items()}
        clients, shipments = self._clients(problem, visits, required, objective)
        self.data = ProblemData(
            [Location(0, 0) for _ in range(energy[0].shape[0])],
            clients,
            [Depot(location) for location in range(self._count, energy[0].shape[0])],
            self._vehicles(math.inf, 0.0),
            energy,
            time,
            shipments=shipments,
        )

    def limited(self, end_s: float = math.inf, left_j: float = 0.0) -> ProblemData:
        """The same model with every worker at its charger by `end_s`, with at least `left_j` left."""
        return self.data.replace(vehicle_types=self._vehicles(end_s, left_j))

    def complete(self) -> ProblemData:
        """The same model with every visit required."""
        required = np.ones(self._count, np.bool_)
        clients, shipments = self._clients(self._problem, self._visits, required, self._objective)
        return self.data.replace(clients=clients, shipments=shipments)

    def solution(self, data: ProblemData, orders: Sequence[Sequence[int]]) -> Solution:
        """A solution from each worker's visits in order."""
        types = {worker: index for index, workers in enumerate(self._equal) for worker in workers}
        routes = [([self._activities[visit] for visit in order], types[w]) for w, order in enumerate(orders) if order]
        return Solution(data, [Route(data, activities, vehicle_type) for activities, vehicle_type in routes])

    def orders(self, solution: Solution) -> list[list[int]]:
        """Each worker's visits in order."""
        orders: list[list[int]] = [[] for _ in self._end_of]
        free = [iter(workers) for workers in self._equal]
        for route in solution.routes():
            visits = [self._visit_of.get((activity.type, activity.idx)) for activity in route]
            orders[next(free[route.vehicle_type()])] = [visit for visit in visits if visit is not None]
        return orders

    def _end_index(self, problem: Problem, worker: int) -> int:
        key = (int(self._team.profile[worker]), *problem.workers[worker].ends)
        return self._end_sets.index(key) if key in self._end_sets else -1

    def _scales(self, visits: VisitArrays) -> tuple[float, float]:
        sample = np.unique(visits.place)[:: max(1, len(visits.place) // 100)]
        scales = []
        for matrices, service, units in (
            (self._team.energy_j, visits.service_j, J_UNITS),
            (self._team.time_s, visits.service_s, S_UNITS),
        ):
            lengths = matrices[:, sample[:, None], sample[None, :]]
            lengths = lengths[np.isfinite(lengths) & (lengths > 0)]
            typical = float(np.median(lengths)) if lengths.size else 0.0
            typical += float(np.median(service)) if service.size else 0.0
            scales.append(units / typical if typical > 0 else 1.0)
        return scales[0], scales[1]

    def _matrices(self, visits: VisitArrays) -> tuple[list[Matrix], list[Matrix]]:
        """Matrices for each kind of worker; locations are the visits, then a start for each worker, then the ends."""
        team, count = self._team, self._count
        origins = np.concatenate((visits.exit_place, team.start[self._workers])).astype(np.int64)
        forbidden = max(self._budgets, default=0) + 1
        nothing, everything = np.zeros(count), np.ones(count, np.bool_)
        energies: list[Matrix] = []
        times: list[Matrix] = []
        for kind in range(len(set(self._kind_of.values()))):
            of_kind = [worker for worker in self._workers if self._kind_of[worker] == kind]
            profile = int(team.profile[of_kind[0]])
            allowed = np.ones(count, np.bool_) if self._loads else np.ascontiguousarray(visits.allowed[of_kind[0]])
            end_j = np.zeros((len(origins), len(self._end_sets)))
            end_s = np.zeros_like(end_j)
            for worker in of_kind:
                end_j[:, self._end_of[worker]] = team.end_j[worker, origins]
                end_s[:, self._end_of[worker]] = team.end_s[worker, origins]
            energies.append(
                fill_matrix(
                    team.energy_j[profile],
                    origins,
                    visits.place,
                    allowed,
                    visits.service_j,
                    end_j,
                    self._units_per_j,
                    forbidden,
                    True,
                )
            )
            # A missing path is forbidden by its distance; its duration does not matter.
            times.append(
                fill_matrix(
                    team.time_s[profile],
                    origins,
                    visits.place,
                    everything,
                    nothing,
                    end_s,
                    self._units_per_s,
                    0,
                    False,
                )
            )
        return energies, times

    def _budget_units(self, visits: VisitArrays) -> list[int]:
        service_j = float(np.max(visits.service_j)) if self._count else 0.0
        longest = math.ceil((greatest(self._team.energy_j) + service_j) * self._units_per_j) + 1
        usable = self._team.usable_j[self._workers] * self._units_per_j
        return [min(math.floor(budget + 1e-6), longest * (self._count + 2)) for budget in usable]

    def _vehicles(self, end_s: float, left_j: float) -> list[VehicleType]:
        team, starts = self._team, len(self._workers)
        end_units = self._ceil(min(end_s, team.horizon_s))
        singles = self._load_kg[self._singles]
        most_kg = float(np.abs(self._load_kg).sum())
        vehicles = []
        for index, worker in enumerate(self._workers):
            ready = self._floor(team.ready_s[worker])
            budget = self._budgets[index] - math.ceil(left_j * self._units_per_j)
            capacity = [self._count if worker in load.workers else 0 for load in self._loads]
            carried = [0] * len(capacity)
            if most_kg > 0:
                start_kg = float(team.load_kg[worker])
                capacity.append(math.floor(min(team.capacity_kg[worker], most_kg + start_kg) * KG_UNITS + ROUNDING))
                # The model loads at the start what its deliveries without a pickup need.
                carried.append(_grams(max(0.0, start_kg + float(singles[singles < 0].sum()))))
            vehicles.append(
                VehicleType(
                    num_available=len(self._equal[index]),
                    capacity=capacity,
                    initial_load=carried,
                    start_depot=index,
                    end_depot=starts + self._end_of[worker],
                    tw_early=min(ready, end_units),
                    tw_late=end_units,
                    # A worker that is not ready in time does nothing: its shift has no length.
                    shift_duration=max(end_units - ready, 0),
                    max_distance=max(budget, 0),
                    profile=self._kind_of[worker],
                )
            )
        return vehicles

    def _clients(
        self, problem: Problem, visits: VisitArrays, required: NDArray[np.bool_], objective: Objective
    ) -> tuple[list[Client], list[Shipment]]:
        prizes = visits.prize_j * self._units_per_j
        if objective is not Objective.ENERGY and len(prizes):
            # A prize then outweighs the longest detour to it.
            least = float(np.min(prizes, where=prizes > 0, initial=math.inf))
            prizes = prizes * max(1.0, 2.0 * max(self._budgets, default=1) / least)
        prizes = np.minimum(prizes, PRIZE_LIMIT / max(1, self._count))
        load_kg = visits.load_kg
        with_loads = bool(load_kg.any())
        clients = []
        for visit in self._singles:
            job = problem.jobs[visits.job[visit]]
            needed = [int(job.id in load.jobs) for load in self._loads]
            early, late, service = self._times(visits, visit)
            clients.append(
                Client(
                    location=visit,
                    delivery=needed + [_grams(max(0.0, -load_kg[visit]))] * with_loads,
                    pickup=[0] * len(needed) + [_grams(max(0.0, load_kg[visit]))] * with_loads,
                    # Two robots of a team job never are one and the same, if being at it takes time.
                    service_duration=max(service, 1) if job.robots > 1 else service,
                    tw_early=early,
                    tw_late=late,
                    prize=math.floor(prizes[visit]),
                    required=bool(required[visit]),
                )
            )
        shipments = []
        for pair in self._pairs:
            jobs = {problem.jobs[visits.job[visit]].id for visit in pair}
            needed = [int(not load.jobs.isdisjoint(jobs)) for load in self._loads]
            carried_kg = max(abs(float(load_kg[visit])) for visit in pair)
            (early, late, service), (later_early, later_late, later_service) = (
                self._times(visits, visit) for visit in pair
            )
            shipments.append(
                Shipment(
                    *pair,
                    pickup_tw_early=early,
                    pickup_tw_late=late,
                    pickup_service_duration=service,
                    delivery_tw_early=later_early,
                    delivery_tw_late=max(early, later_late),  # PyVRP refuses pairs that nobody can do
                    delivery_service_duration=later_service,
                    amount=needed + [_grams(carried_kg)] * with_loads,
                    prize=math.floor(prizes[pair[0]]),
                    required=bool(required[pair[0]] or required[pair[1]]),
                )
            )
        return clients, shipments

    def _times(self, visits: VisitArrays, visit: int) -> tuple[int, int, int]:
        """Earliest and latest start, and service duration."""
        early, late = self._floor(visits.earliest_s[visit]), self._ceil(visits.latest_s[visit])
        return early, max(early, late), self._floor(visits.service_s[visit])

    def _floor(self, time_s: float) -> int:
        units = time_s * self._units_per_s
        return math.floor(units) if units < FOREVER else FOREVER

    def _ceil(self, time_s: float) -> int:
        units = time_s * self._units_per_s
        return math.ceil(units) if units < FOREVER else FOREVER


def _grams(load_kg: float) -> int:
    return math.ceil(load_kg * KG_UNITS - ROUNDING)


@njit(cache=True, nogil=True)
def fill_matrix(
    legs: Floats,
    origins: Indices,
    places: Indices,
    allowed: NDArray[np.bool_],
    service: Floats,
    ends: Floats,
    scale: float,
    forbidden: int,
    is_up: bool,
) -> NDArray[np.int64]:
    """Return one matrix of a profile.

    Args:
        legs: (n, n) joules or seconds between places.
        origins: (m,) places at the ends of the visits, then the starts.
        places: (visits,) of the visits.
        allowed: (visits,) visits that this kind of worker may make.
        service: (visits,) added to every path to the visit.
        ends: (m, e) from each place to each end.
        scale: units per joule or second.
        forbidden: value where there is no path.
        is_up: round up; down otherwise.

    Returns:
        (m + e, m + e); rows of the ends and columns of the starts are 0, because no path uses them.

    """
    count, end_count = ends.shape
    visits = len(allowed)
    matrix = np.zeros((count + end_count, count + end_count), np.int64)
    for row in range(count):
        here = origins[row]
        for column in range(visits):
            if row != column:
                length = legs[here, places[column]] + service[column] if allowed[column] else math.inf
                matrix[row, column] = _units(length, scale, forbidden, is_up)
        for column in range(end_count):
            matrix[row, count + column] = _units(ends[row, column], scale, forbidden, is_up)
    return matrix


@njit(cache=True, nogil=True)
def _units(length: float, scale: float, forbidden: int, is_up: bool) -> int:
    if not length < math.inf:
        return forbidden
    return math.ceil(length * scale - ROUNDING) if is_up else math.floor(length * scale)


def greatest(lengths: Floats) -> float:
    """The longest finite path; 0 if there is none."""
    most = float(np.max(lengths)) if lengths.size else 0.0
    return most if math.isfinite(most) else float(np.max(lengths, where=np.isfinite(lengths), initial=0.0))
