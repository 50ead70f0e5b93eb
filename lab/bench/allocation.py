"""Gaps of task allocation to the best known solutions of public routing instances, beside PyVRP alone.

A customer becomes a job, a vehicle a robot that starts and ends at the depot, distance energy. With time windows,
distance is time too. A pair of pickup and delivery becomes two jobs of one robot, a recharging station a charger. The
first line shows the format: VRPLIB (https://github.com/PyVRP/VRPLIB), Solomon's, Li and Lim's, or Schneider's.
Gehring and Homberger use Solomon's.
"""

import math
import statistics
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyvrp
import vrplib
from numpy.typing import NDArray

from robrain.algorithms.allocation.allocator import Allocator
from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.algorithms.allocation.plan import Plan, make_plan
from robrain.algorithms.allocation.problem import Job, Objective, Problem, Worker
from robrain.algorithms.allocation.validate import validate
from robrain.deploy.command_line.terminal import print_line
from robrain.deploy.errors import InstanceError, UsageError
from robrain.lab.bench.figure import Figure, at_most, timing
from robrain.lab.bench.mapping_plan import BenchPlan, run_all
from robrain.protocol.reasons import sentence_of

BEYOND_PYVRP_PERCENT = at_most(1.0)
CHARGING_GAP_PERCENT = at_most(2.0)
SUFFIXES = (".txt", ".vrp")
DECIMALS = {"solomon": 1, "vrplib": 0, "li_lim": 4, "schneider": 4}
"""Decimals of a distance in published values. Solomon's set cuts after the first decimal (Kohl and others, 2-Path
Cuts for the Vehicle Routing Problem with Time Windows, Transportation Science 33(1), 1999). TSPLIB's EUC_2D rounds to
an integer (Reinelt, TSPLIB - A Traveling Salesman Problem Library, ORSA J. Computing 3(4), 1991). Li and Lim's and
Schneider's sets have distances in floats, and PyVRP alone gets them with four decimals, rounded up.
"""
BEST_FILE = Path(__file__).with_name("best_known.toml")
PRIZE_FACTOR = 4.0
"""Value of a job, as a multiple of the longest return trip: omitting a job never pays."""


class PublicInstance(msgspec.Struct, frozen=True, kw_only=True):
    """An instance as it was read."""

    name: str
    problem: Problem
    decimals: int
    """Decimals of its distances, times and loads."""
    best: float | None = None
    """Best known value; None if it is unknown."""


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
    routes: list[list[int]]
    """Customers of each vehicle that is used, numbered from 1 as in the file."""
    remark: str = ""
    """Reason why the value cannot be compared; empty if it can."""


def read_public(path: Path) -> PublicInstance:
    """Read a file, and the best known value: the cost in the .sol file beside it, or the one in `best_known.toml`.

    Where the best known solution has the fewest vehicles possible, no more vehicles are used.

    Raises:
        InstanceError: it cannot be read, or has a kind that our model does not support; the text names file and key.

    """
    known: list[float] = next((each[name] for each in _best_known() if (name := path.stem.lower()) in each), [])
    try:
        lines = path.read_text().split("\n")
        kind = _kind(lines[0])
        found = READERS[kind](lines) if kind in READERS else vrplib.read_instance(path, instance_format=kind)
        if len(known) > 1:
            found["vehicles"] = min(int(found["vehicles"]), int(known[1]))
    except OSError as error:
        raise InstanceError(f"{path}: {error.strerror or error}") from error
    except Exception as error:  # the external reader raises any exception of its parser
        raise InstanceError(f"{path}: cannot be read as a {kind} file: {error}") from error
    try:
        made = _instance(path, found, DECIMALS[kind])
        best = read_best(path)
        return msgspec.structs.replace(made, best=known[0] if best is None and known else best)
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
    *,
    deadline_s: float | None = None,
    iterations: int | None = None,
    seed: int = 0,
) -> PublicResult:
    """Have an allocator plan an instance.

    Args:
        instance: as `read_public` gives it.
        allocator: one with the objective `energy`.
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
    return _result(instance, plan)


def solve_alone(instance: PublicInstance, *, deadline_s: float, seed: int = 0) -> PublicResult:
    """Have PyVRP solve an instance with its own defaults and one type of vehicle, in seconds of CPU time.

    Raises:
        InstanceError: its plan breaks a limit of the instance (it never should).

    """
    problem, scale = instance.problem, 10**instance.decimals
    worker, deliveries = problem.workers[0], problem.deliveries
    paired = {*deliveries, *deliveries.values()}
    singles = [index for index in range(len(problem.jobs)) if index not in paired]
    distances = np.ceil(problem.energy_j[0] * scale - 1e-6).astype(np.int64)
    steps = {index: _step(problem.jobs[index], scale) for index in range(len(problem.jobs))}
    amounts = {index: [round(abs(job.load_kg) * scale)] for index, job in enumerate(problem.jobs)}
    capacity = min(worker.capacity_kg, sum(abs(job.load_kg) for job in problem.jobs))
    limit: dict[str, Any] = (
        {} if worker.usable_j > distances.sum() / scale else {"max_distance": math.floor(worker.usable_j * scale)}
    )
    end: dict[str, Any] = {"tw_late": math.floor(problem.horizon_s * scale)} if math.isfinite(problem.horizon_s) else {}
    data = pyvrp.ProblemData(
        [pyvrp.Location(0, 0) for _ in distances],
        [pyvrp.Client(problem.jobs[index].place, pickup=amounts[index], **steps[index]) for index in singles],
        [pyvrp.Depot(worker.start)],
        [pyvrp.VehicleType(len(problem.workers), [math.floor(capacity * scale + 1e-6)], **limit, **end)],
        [distances],
        [distances],
        shipments=[
            pyvrp.Shipment(
                problem.jobs[pickup].place,
                problem.jobs[delivery].place,
                amount=amounts[pickup],
                **{f"pickup_{key}": value for key, value in steps[pickup].items()},
                **{f"delivery_{key}": value for key, value in steps[delivery].items()},
            )
            for pickup, delivery in deliveries.items()
        ],
    )
    end_s = time.process_time() + deadline_s
    best = pyvrp.solve(data, lambda _: time.process_time() >= end_s, seed, collect_stats=False, display=False).best
    pairs = list(deliveries.items())
    orders: list[list[str]] = []
    for route in best.routes() if best.is_feasible() else []:
        rows = [
            singles[one.idx] if one.is_client() else pairs[one.idx][one.is_delivery()]
            for one in route
            if not one.is_depot()
        ]
        orders.append([problem.jobs[row].id for row in rows])
    orders += [[] for _ in range(len(problem.workers) - len(orders))]
    plan = make_plan(problem, orders, Objective.ENERGY)
    if plan is None or (broken := validate(problem, plan)):
        raise InstanceError(f"{instance.name}: the plan of PyVRP is wrong: {broken[0] if plan else 'a cycle'}")
    return _result(instance, plan)


def _step(job: Job, scale: int) -> dict[str, Any]:
    latest_s = job.latest_s - job.service_s
    window = {"tw_late": math.floor(latest_s * scale + 1e-6)} if math.isfinite(latest_s) else {}
    return {"tw_early": math.ceil(job.earliest_s * scale), "service_duration": round(job.service_s * scale), **window}


def _result(instance: PublicInstance, plan: Plan) -> PublicResult:
    routes = [[instance.problem.job_index[job] for job in route.jobs] for route in plan.routes if route.stops]
    return PublicResult(
        instance=instance.name,
        customers=len(instance.problem.jobs),
        vehicles=len(routes),
        value=round(plan.cost_j, 6),
        best=instance.best,
        gap=plan.cost_j / instance.best - 1 if instance.best and not plan.unassigned else None,
        left_out=len(plan.unassigned),
        routes=[[index + 1 for index in route] for route in routes],
        remark=_remark(plan),
    )


def _remark(plan: Plan) -> str:
    if not plan.unassigned:
        return ""
    first = plan.unassigned[0]
    reason = f": {sentence_of(first.reason)}" if first.reason else ""
    return f"{len(plan.unassigned)} customers are left out, {first.job}{reason}"


def _best_known() -> list[dict[str, list[float]]]:
    """The tables of `best_known.toml`: distance, and the number of vehicles where they are minimised first."""
    return list(tomllib.loads(BEST_FILE.read_text()).values())


def _read_li_lim(lines: list[str]) -> dict[str, Any]:
    """Number of vehicles and capacity; then each node's x, y, demand, window, service, pickup and delivery."""
    vehicles, capacity, _ = (int(word) for word in lines[0].split())
    table = np.array([[float(word) for word in line.split()] for line in lines[1:] if line.strip()])
    if table.ndim != 2 or table.shape[1] != 9 or (table[:, 0] != np.arange(len(table))).any():
        raise ValueError("expected a line of nine numbers for each node, in order")
    return {
        "vehicles": vehicles,
        "capacity": capacity,
        "edge_weight": np.hypot(*(table[:, None, 1:3] - table[None, :, 1:3]).transpose(2, 0, 1)),
        "demand": table[:, 3],
        "time_window": table[:, 4:6],
        "service_time": table[:, 6],
        "pickup": table[:, 7].astype(np.int64),
    }


def _read_schneider(lines: list[str]) -> dict[str, Any]:
    """Depot, stations and customers; then battery, capacity, consumption, inverse charging rate and velocity."""
    rows = [words for line in lines[1:] if len(words := line.split()) == 8]
    rows.sort(key=lambda words: "dcf".index(words[1]))  # customers are numbered from 1, in the order of the file
    figures = {line[0]: float(line.split("/")[1]) for line in lines if line.count("/") == 2}
    table = np.array([[float(word) for word in words[2:]] for words in rows])
    stations = sum(words[1] == "f" for words in rows)
    if [words[1] for words in rows].count("d") != 1 or not stations or figures["v"] != 1.0:
        raise ValueError("expected one depot, stations, and a velocity of 1")
    return {
        "capacity": figures["C"],
        "edge_weight": np.hypot(*(table[:, None, :2] - table[None, :, :2]).transpose(2, 0, 1)),
        "demand": table[:, 2],
        "time_window": table[:, 3:5],
        "service_time": table[:, 5],
        "stations": stations,
        "vehicles": len(rows) - 1 - stations,
        "range": figures["Q"] / figures["r"],
        "charge_rate": 1.0 / (figures["g"] * figures["r"]),
    }


READERS: dict[str, Callable[[list[str]], dict[str, Any]]] = {"li_lim": _read_li_lim, "schneider": _read_schneider}
"""Formats that VRPLIB's package does not read."""


def _kind(first_line: str) -> str:
    words = first_line.split()
    if words[:1] == ["StringID"]:
        return "schneider"
    return "vrplib" if ":" in first_line else "li_lim" if len(words) == 3 else "solomon"


def _instance(path: Path, found: dict[str, Any], decimals: int) -> PublicInstance:
    if "edge_weight" not in found:
        raise ValueError("EDGE_WEIGHT_TYPE: expected distances, got none")
    depots = np.atleast_1d(found.get("depot", np.array([0])))
    if len(depots) != 1 or int(depots[0]) != 0:
        raise ValueError(f"DEPOT_SECTION: expected node 1 as the only depot, got {[int(node) + 1 for node in depots]}")
    for key in ("backhaul", "vehicles_depot", "vehicles_allowed_clients", "release_time"):
        if key in found:
            raise ValueError(f"{key.upper()}_SECTION: not supported by the allocators' model")
    distances = np.asarray(found["edge_weight"], dtype=np.float64)
    distances = distances if decimals > 1 else _rounded(distances, decimals)
    count = len(distances)
    stations = int(found.get("stations", 0))
    charging: dict[str, Any] = {}
    if stations:
        chargers = tuple(range(count - stations, count))
        charging = {"chargers": chargers, "full_j": found["range"], "charge_w": found["charge_rate"]}
    windows = np.asarray(found.get("time_window", np.tile([0.0, math.inf], (count, 1))), dtype=np.float64)
    service_s = np.broadcast_to(np.asarray(found.get("service_time", 0.0), dtype=np.float64), (count,))
    prize = PRIZE_FACTOR * float(distances.max()) * 2 + 1.0
    demand = np.asarray(found.get("demand", np.zeros(count)), dtype=np.float64)
    pickups = np.asarray(found.get("pickup", np.zeros(count)), dtype=np.int64)
    if ((pickups < 0) | (pickups >= count)).any():
        raise ValueError(f"expected pickups from 1 to {count - 1}")
    jobs = tuple(
        Job(
            id=f"c{customer}",
            place=customer,
            prize_j=prize,
            service_s=float(service_s[customer]),
            earliest_s=float(windows[customer][0]),
            # There a window is that of the beginning, here it is that of the end.
            latest_s=float(windows[customer][1] + service_s[customer]),
            load_kg=float(demand[customer]),
            after=(f"c{pickups[customer]}",) if pickups[customer] else (),
            same_worker_as=f"c{pickups[customer]}" if pickups[customer] else "",
        )
        for customer in range(1, count - stations)
    )
    longest = float(found.get("range", found.get("vehicles_max_distance", math.inf)))
    # DISTANCE there limits a route's length and service together, which is its duration here.
    horizon_s = min(float(windows[0][1]), float(found.get("distance", math.inf)))
    workers = tuple(
        Worker(
            name=f"v{number}",
            start=0,
            ends=(0,),
            usable_j=min(longest, float(2 * distances.sum()) + 1.0),
            capacity_kg=float(found.get("capacity", math.inf)),
            **charging,
        )
        for number in range(_vehicles(path, found, count))
    )
    problem = Problem(jobs=jobs, workers=workers, energy_j=distances[None], time_s=distances[None], horizon_s=horizon_s)
    return PublicInstance(
        name=str(found.get("name", path.stem)),
        problem=problem,
        decimals=decimals,
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


class AllocationCase(msgspec.Struct, frozen=True, kw_only=True):
    """One instance, and the CPU time for it."""

    instance: str
    """Path of its file."""
    seconds: float
    seed: int


class AllocationRun(msgspec.Struct, frozen=True, kw_only=True):
    """An instance, solved by robrain's allocator and by PyVRP alone in equal CPU time."""

    case: AllocationCase
    robrain: PublicResult
    pyvrp: PublicResult | None
    """None with recharging stations, which PyVRP's model does not have."""


def choose(paths: Sequence[Path], seconds: float, seed: int) -> BenchPlan[AllocationCase]:
    """Make the runs from the options (UsageError if one is wrong); of a folder, all .txt and .vrp files."""
    if seconds <= 0:
        raise UsageError(f"--seconds {seconds:g}: expected a number above 0")
    files = [
        file
        for path in paths
        for file in (sorted(one for one in path.iterdir() if one.suffix in SUFFIXES) if path.is_dir() else [path])
    ]
    return BenchPlan(cases=[AllocationCase(instance=str(file), seconds=seconds, seed=seed) for file in files], jobs=1)


def run_bench(plan: BenchPlan[AllocationCase], json_file: Path | None = None) -> None:
    """Solve all instances; print a line for each, and the figures at the end."""
    run_all("allocation", plan, run_case, _report, figures, json_file)


def run_case(case: AllocationCase) -> AllocationRun:
    """Solve one instance twice (InstanceError if it cannot be read)."""
    instance = read_public(Path(case.instance))
    allocator = OptimalAllocator(Objective.ENERGY, time.process_time)
    allocator.plan(instance.problem, iterations=1)  # compiles the kernels, which may take longer than the search
    robrain = solve_public(instance, allocator, deadline_s=case.seconds, seed=case.seed)
    if instance.problem.workers[0].chargers:
        return AllocationRun(case=case, robrain=robrain, pyvrp=None)
    alone = solve_alone(instance, deadline_s=case.seconds, seed=case.seed)
    return AllocationRun(case=case, robrain=robrain, pyvrp=alone)


def _report(runs: list[AllocationRun]) -> None:
    run = runs[-1]
    alone = "" if run.pyvrp is None else f"; PyVRP alone {_words(run.pyvrp)}"
    print_line(f"{run.robrain.instance}: robrain {_words(run.robrain)}{alone}")


def _words(result: PublicResult) -> str:
    if result.left_out:
        return result.remark
    gap = "" if result.gap is None else f", gap {100 * result.gap:.2f} %"
    return f"{result.vehicles} vehicles, distance {result.value:.2f}{gap}"


def figures(runs: Sequence[AllocationRun]) -> Iterator[Figure]:
    """Mean gaps in percent, of instances whose customers are all served."""
    pairs = [(run.robrain, run.pyvrp) for run in runs if run.pyvrp is not None]
    charging = [run.robrain for run in runs if run.pyvrp is None]
    for name, results, bound in (
        ("gap to the best known values", [robrain for robrain, _ in pairs], None),
        ("gap to the best known values, with charging", charging, CHARGING_GAP_PERCENT),
    ):
        beside = f"{len(results)} instances, {sum(bool(result.left_out) for result in results)} with customers left out"
        if gaps := [100 * result.gap for result in results if result.gap is not None]:
            yield timing(name, statistics.mean(gaps), "%", bound, beside)
    both = [(robrain, alone) for robrain, alone in pairs if not robrain.left_out and not alone.left_out]
    if beyond := [100 * (robrain.value / alone.value - 1) for robrain, alone in both]:
        unsolved = f"{sum(bool(alone.left_out) for _, alone in pairs)} that PyVRP does not solve"
        yield timing("distance beyond PyVRP alone", statistics.mean(beyond), "%", BEYOND_PYVRP_PERCENT, unsolved)
