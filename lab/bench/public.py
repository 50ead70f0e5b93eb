"""Public vehicle-routing instances, read by `vrplib` and solved through the allocators' own model.

A customer becomes a job, a vehicle a robot that starts and ends at the depot, distance energy; with time windows,
distance is time too. Demands, and with them the vehicles' capacity, are omitted from the problem that is solved, as our
jobs have none. A plan whose routes exceed the capacity is marked: its value is then less than the instance allows and
cannot be compared. A plan within the capacity can be compared: the best plan without capacities is also the best with
them if it keeps them.
"""

import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import vrplib
from numpy.typing import NDArray

from robrain.algorithms.allocation.allocator import Allocator
from robrain.algorithms.allocation.plan import Plan
from robrain.algorithms.allocation.problem import Job, Problem, Worker
from robrain.algorithms.allocation.validate import validate
from robrain.deploy.errors import InstanceError
from robrain.protocol.reasons import sentence_of

DECIMALS = {"solomon": 1, "vrplib": 0}
"""Decimals of a distance in published values. Solomon's set cuts after the first decimal (Kohl and others, 2-Path
Cuts for the Vehicle Routing Problem with Time Windows, Transportation Science 33(1), 1999). TSPLIB's EUC_2D rounds to
an integer (Reinelt, TSPLIB - A Traveling Salesman Problem Library, ORSA J. Computing 3(4), 1991).
"""
PRIZE_FACTOR = 4.0
"""Value of a job, as a multiple of the longest return trip: omitting a job never pays."""


class PublicInstance(msgspec.Struct, frozen=True, kw_only=True):
    """An instance as it was read."""

    name: str
    problem: Problem
    demand: tuple[float, ...]
    """Of each job; zeros if the instance has none."""
    capacity: float
    """Of each vehicle; infinite if the instance has none."""


class PublicResult(msgspec.Struct, frozen=True, kw_only=True):
    """Quality of an instance's solution."""

    instance: str
    customers: int
    vehicles: int
    """Used."""
    value: float
    """Length of all routes; all customers are served unless `left_out` lists some."""
    best: float | None
    """The best known that it is compared with."""
    gap: float | None
    """`value / best - 1`; None without a best."""
    left_out: int
    over_capacity: int
    """Routes that carry more than a vehicle holds."""
    routes: list[list[int]]
    """Customers of each vehicle that is used, numbered from 1 as in the file."""
    remark: str = ""
    """Reason why the value cannot be compared; empty if it can."""


def read_public(path: Path) -> PublicInstance:
    """Read a .vrp (VRPLIB) or .txt (Solomon) file.

    Raises:
        InstanceError: it cannot be read, or has a kind that our model does not support; the text names file and key.

    """
    kind = "solomon" if path.suffix.lower() == ".txt" else "vrplib"
    try:
        found = vrplib.read_instance(path, instance_format=kind)
    except OSError as error:
        raise InstanceError(f"{path}: {error.strerror or error}") from error
    except Exception as error:  # the external reader raises any exception of its parser
        raise InstanceError(f"{path}: cannot be read as a {kind} file: {error}") from error
    try:
        return _instance(path, found, DECIMALS[kind])
    except (ValueError, TypeError, IndexError) as error:
        raise InstanceError(f"{path}: {error}") from error


def read_best(path: Path) -> float | None:
    """The value of the .sol file beside an instance; None if there is none.

    Raises:
        InstanceError: there is one, and it names no cost.

    """
    beside = path.with_suffix(".sol")
    if not beside.exists():
        return None
    cost = vrplib.read_solution(beside).get("cost")
    if not isinstance(cost, int | float):
        raise InstanceError(f"{beside}: expected a line `Cost NUMBER`, got {cost!r}")
    return float(cost)


def solve_public(
    instance: PublicInstance,
    allocator: Allocator,
    best: float | None,
    *,
    deadline_s: float | None = None,
    iterations: int | None = None,
    seed: int = 0,
) -> PublicResult:
    """Have an allocator plan an instance.

    Args:
        instance: as `read_public` gives it.
        allocator: one with the objective `energy`.
        best: value to compare with.
        deadline_s: as for `Allocator.plan`.
        iterations: likewise; one of the two is needed.
        seed: likewise.

    Raises:
        InstanceError: the plan breaks a limit of the instance (it never should).

    """
    problem = instance.problem
    plan = allocator.plan(problem, deadline_s=deadline_s, iterations=iterations, seed=seed)
    if broken := validate(problem, plan):
        raise InstanceError(f"{instance.name}: the plan is wrong: {broken[0]}")
    routes = [[problem.job_index[job] for job in route.jobs] for route in plan.routes if route.stops]
    over = sum(sum(instance.demand[index] for index in route) > instance.capacity for route in routes)
    is_comparable = not over and not plan.unassigned
    gap = plan.cost_j / best - 1 if best and is_comparable else None
    return PublicResult(
        instance=instance.name,
        customers=len(problem.jobs),
        vehicles=len(routes),
        value=round(plan.cost_j, 6),
        best=best,
        gap=gap,
        left_out=len(plan.unassigned),
        over_capacity=over,
        routes=[[index + 1 for index in route] for route in routes],
        remark=_record(plan, over, instance.capacity),
    )


def _record(plan: Plan, over: int, capacity: float) -> str:
    if over:
        return (
            f"{over} routes carry more than {capacity:g}: capacities are no part of the model, and so the value is"
            " not comparable"
        )
    if plan.unassigned:
        first = plan.unassigned[0]
        return f"{len(plan.unassigned)} customers are left out, {first.job}: {sentence_of(first.reason)}"
    return ""


def _instance(path: Path, found: dict[str, Any], decimals: int) -> PublicInstance:
    if "edge_weight" not in found:
        raise ValueError("EDGE_WEIGHT_TYPE: expected distances, got none")
    depots = np.atleast_1d(found.get("depot", np.array([0])))
    if len(depots) != 1 or int(depots[0]) != 0:
        raise ValueError(f"DEPOT_SECTION: expected node 1 as the only depot, got {[int(node) + 1 for node in depots]}")
    for key in ("backhaul", "vehicles_depot", "vehicles_allowed_clients", "release_time"):
        if key in found:
            raise ValueError(f"{key.upper()}_SECTION: not supported by the allocators' model")
    distances = _rounded(np.asarray(found["edge_weight"], dtype=np.float64), decimals)
    count = len(distances)
    windows = np.asarray(found.get("time_window", np.tile([0.0, math.inf], (count, 1))), dtype=np.float64)
    service_s = np.broadcast_to(np.asarray(found.get("service_time", 0.0), dtype=np.float64), (count,))
    prize = PRIZE_FACTOR * float(distances.max()) * 2 + 1.0
    jobs = tuple(
        Job(
            id=f"c{customer}",
            place=customer,
            prize_j=prize,
            service_s=float(service_s[customer]),
            earliest_s=float(windows[customer][0]),
            # There a window is that of the beginning, here it is that of the end.
            latest_s=float(windows[customer][1] + service_s[customer]),
        )
        for customer in range(1, count)
    )
    longest = float(found.get("vehicles_max_distance", math.inf))
    # DISTANCE there limits a route's length and service together, which is its duration here.
    horizon_s = min(float(windows[0][1]), float(found.get("distance", math.inf)))
    workers = tuple(
        Worker(name=f"v{number}", start=0, ends=(0,), usable_j=min(longest, float(2 * distances.sum()) + 1.0))
        for number in range(_vehicles(path, found, count))
    )
    demand = np.asarray(found.get("demand", np.zeros(count)), dtype=np.float64)
    problem = Problem(jobs=jobs, workers=workers, energy_j=distances[None], time_s=distances[None], horizon_s=horizon_s)
    return PublicInstance(
        name=str(found.get("name", path.stem)),
        problem=problem,
        demand=tuple(float(each) for each in demand[1:]),
        capacity=float(found.get("capacity", math.inf)),
    )


def _vehicles(path: Path, found: dict[str, Any], count: int) -> int:
    if "vehicles" in found:
        return int(found["vehicles"])
    if "capacity" not in found:
        return 1  # a travelling salesman
    number = str(found.get("name", path.stem)).rpartition("-k")[2]  # A-n32-k5: by convention the name has the number
    return int(number) if number.isdigit() else count - 1


def _rounded(distances: NDArray[np.float64], decimals: int) -> NDArray[np.float64]:
    # The slack is for roots that are slightly below their exact values.
    return np.floor(distances * 10**decimals + 1e-9) / 10**decimals if decimals else np.floor(distances + 0.5)
