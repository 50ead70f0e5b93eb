"""Accuracy of estimates: the ends and energies that a coordinator predicts, beside what its robots need."""

import statistics
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np

from robrain.client.team import Team
from robrain.deploy.command_line.terminal import print_line
from robrain.deploy.errors import UsageError
from robrain.lab.bench.figure import Figure, at_most, between, deterministic
from robrain.lab.bench.mapping_plan import BenchPlan, check_limits, errors_alone, names_of, numbers_of, run_all
from robrain.protocol.errors import CallError
from robrain.protocol.messages.tasks.task_messages import TaskEstimate, TaskFilter, TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.stock_kinds import INSPECT, VISIT
from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.faults.fault_spec import FaultKind, FaultSpec
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.scenarios.scenario_file import MAX_ROBOTS, MAX_SEED
from robrain.sim.world.robot_specs import RobotSpec

EXPLORED_S = {"depot": 110.0, "office": 140.0, "hospital": 200.0}
"""Time for exploration before the tasks."""
LONGEST_S = 300.0
"""Time after the last submission in which tasks may end."""
TASK_S = 80.0
"""A robot gets a task in this time on average (chosen: short queues build up, and are worked off)."""
CLEARANCE_M = 0.6
"""Of the places, from walls."""
SERVICES_S = (0.0, 5.0, 20.0)
BLOCKED_SHARE = 0.1
BLOCKED_S = 30.0
LOW_SHARE, LOW_SOC = 0.25, 0.4
"""Share of the robots that begin with little charge, and have to charge soon."""
CHECK_S = 0.5
TRIES_MAX = 100
"""Places that a team may refuse in turn."""
QUEUED_PERCENT, BEGUN_PERCENT, ENERGY_PERCENT = at_most(15.0), at_most(10.0), at_most(7.0)
IN_INTERVAL_PERCENT = between(85.0, 95.0)
WIDTH = 120


class EstimatesCase(msgspec.Struct, frozen=True, kw_only=True):
    """One run."""

    scenario: str
    robots: int
    seed: int
    tasks: int
    connect: str = ""
    """Endpoint of a live team that knows the floor; empty for a run in lockstep."""


class EstimatedTask(msgspec.Struct, frozen=True, kw_only=True):
    """The estimates of a task that was done, beside the truth."""

    kind: str
    ends_in_s: float
    """Predicted when it was submitted."""
    ended_in_s: float
    is_inside: bool
    """Whether the end was in the 90 % interval."""
    begun_ends_in_s: float
    """Predicted when its robot set out."""
    begun_ended_in_s: float
    begun_is_inside: bool
    energy_j: float
    """Predicted when its robot set out."""
    spent_j: float


class EstimatesRun(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a run."""

    case: EstimatesCase
    done: tuple[EstimatedTask, ...] = ()
    without: int = 0
    """Tasks that were done and had no estimate when they were submitted, or none when they began."""
    undone: int = 0


def run_case(case: EstimatesCase) -> EstimatesRun:
    """Let a team explore, submit tasks at random times, and compare each estimate with the end.

    A live team must have explored already. Its robots are not blocked.
    """
    rng = np.random.default_rng([case.seed, case.robots])
    low = RobotSpec(hardware={"battery": {"soc_at_start": LOW_SOC}})
    roster = (low,) * max(1, round(LOW_SHARE * case.robots))
    scenario = Scenario.builtin(case.scenario).replace(robots=case.robots, seed=case.seed, roster=roster)
    length_s = case.tasks * TASK_S / case.robots
    world, begin_s = scenario.world(), EXPLORED_S[case.scenario]
    starts = [Point2D(robot.start.x_m, robot.start.y_m) for robot in world.robots]
    cells = np.argwhere(world.plan.reachable(starts, CLEARANCE_M))
    faults = tuple(_faults(case.robots, begin_s, length_s, rng))
    if case.connect:
        with Team.connect(case.connect) as team:
            return _measured(case, team, world.plan, cells, length_s, rng)
    with errors_alone(), scenario.replace(faults=faults).team() as team:
        team.run_for(begin_s)
        return _measured(case, team, world.plan, cells, length_s, rng)


def _faults(robots: int, begin_s: float, length_s: float, rng: np.random.Generator) -> Iterator[FaultSpec]:
    """Some robots are blocked for a while."""
    for name in rng.permutation(robots)[: max(1, round(BLOCKED_SHARE * robots))].tolist():
        at_s = begin_s + float(rng.uniform(0.0, length_s))
        yield FaultSpec(robot=f"r{name + 1}", kind=FaultKind.HANG, at_s=at_s, until_s=at_s + BLOCKED_S)


def _measured(
    case: EstimatesCase,
    team: Team,
    plan: FloorPlan,
    cells: np.ndarray,
    length_s: float,
    rng: np.random.Generator,
) -> EstimatesRun:
    due_s = sorted(rng.uniform(0.0, length_s, case.tasks).tolist())
    begin_s, names = team.now_s, list[str]()
    queued: dict[str, tuple[float, TaskEstimate]] = {}
    begun: dict[str, tuple[float, TaskEstimate]] = {}
    records: dict[str, TaskRecord] = {}
    while len(records) < case.tasks and team.now_s < begin_s + length_s + LONGEST_S:
        while len(names) < case.tasks and due_s[len(names)] <= team.now_s - begin_s:
            names.append(_submit(team, plan, cells, rng))
        team.run_for(CHECK_S)
        for record in team.list(TaskFilter(limit=10_000)):
            name, estimate = record.task.id, record.estimate
            if name in records or name not in names:
                continue
            if record.state.ended:
                records[name] = record
            elif estimate is not None:
                queued.setdefault(name, (team.now_s, estimate))
                if record.state is TaskState.RUNNING:
                    begun.setdefault(name, (team.now_s, estimate))
    done = [one for one in records.values() if one.state is TaskState.DONE]
    compared = tuple(
        _compared(one, *queued[one.task.id], *begun[one.task.id])
        for one in done
        if one.task.id in queued and one.task.id in begun
    )
    return EstimatesRun(case=case, done=compared, without=len(done) - len(compared), undone=case.tasks - len(done))


def _submit(team: Team, plan: FloorPlan, cells: np.ndarray, rng: np.random.Generator) -> str:
    """Submit a task at a place that is known to be free (UsageError if the team refuses many)."""
    for _ in range(TRIES_MAX):
        row, column = cells[rng.integers(len(cells))].tolist()
        place = plan.geometry.center_of(row, column)
        service_s = SERVICES_S[rng.integers(len(SERVICES_S))]
        try:
            if rng.random() < 0.3:
                return team.submit(INSPECT, place=place).task.id
            return team.submit(VISIT, place=place, service_s=service_s).task.id
        except CallError as error:  # the team's map has something there
            refusal = error
    raise UsageError(f"the team refuses {TRIES_MAX} places in turn; is it on another floor? {refusal}")


def _compared(
    record: TaskRecord, queued_s: float, queued: TaskEstimate, begun_s: float, begun: TaskEstimate
) -> EstimatedTask:
    end_s = record.changed_ns / 1e9
    return EstimatedTask(
        kind=record.task.kind,
        ends_in_s=queued.ends_in_s,
        ended_in_s=end_s - queued_s,
        is_inside=queued.ends_low_s <= end_s - queued_s <= queued.ends_high_s,
        begun_ends_in_s=begun.ends_in_s,
        begun_ended_in_s=end_s - begun_s,
        begun_is_inside=begun.ends_low_s <= end_s - begun_s <= begun.ends_high_s,
        energy_j=begun.energy_j,
        spent_j=float(record.result.get("energy_j", 0.0)),
    )


def choose(
    scenarios: str, robots: str, seeds: str, tasks: int, jobs: int, connect: str | None = None
) -> BenchPlan[EstimatesCase]:
    """Make the runs from the options (UsageError if one is wrong)."""
    check_limits(jobs, 1.0)
    cases = [
        EstimatesCase(scenario=name, robots=count, seed=seed, tasks=tasks, connect=connect or "")
        for name in names_of("--scenarios", scenarios, EXPLORED_S)
        for count in numbers_of("--robots", robots, 1, MAX_ROBOTS)
        for seed in numbers_of("--seeds", seeds, 0, MAX_SEED)
    ]
    return BenchPlan(cases=cases, jobs=jobs)


def run_bench(plan: BenchPlan[EstimatesCase], json_file: Path | None = None) -> None:
    """Execute all runs; print a line for each, and the figures at the end."""
    run_all("estimates", plan, run_case, _report, figures, json_file, width=WIDTH)


def _report(runs: list[EstimatesRun]) -> None:
    case = runs[-1].case
    shown = ", ".join(f"{one.name} {one.value:.1f} %" for one in figures(runs[-1:]) if one.value is not None)
    print_line(f"{case.scenario}, {case.robots} robots, seed {case.seed}: {shown}")


def figures(runs: Sequence[EstimatesRun]) -> Iterator[Figure]:
    """Median errors in percent, and the share of ends within the 90 % interval."""
    done = [one for run in runs for one in run.done]
    if not done:
        return
    beside = f"{len(done)} tasks; {sum(run.without for run in runs)} without an estimate"
    queued = _median_percent((one.ends_in_s, one.ended_in_s) for one in done)
    yield deterministic("error of the end, at submission", queued, "%", QUEUED_PERCENT, beside)
    begun = _median_percent((one.begun_ends_in_s, one.begun_ended_in_s) for one in done)
    yield deterministic("error of the end, at the start of driving", begun, "%", BEGUN_PERCENT)
    energy = _median_percent((one.energy_j, one.spent_j) for one in done)
    yield deterministic("error of the energy", energy, "%", ENERGY_PERCENT)
    inside = 100.0 * sum(one.is_inside for one in done) / len(done)
    yield deterministic("ends within the interval, at submission", inside, "%", IN_INTERVAL_PERCENT)
    inside = 100.0 * sum(one.begun_is_inside for one in done) / len(done)
    yield deterministic("ends within the interval, at the start of driving", inside, "%", IN_INTERVAL_PERCENT)
    share = 100.0 * sum(run.undone for run in runs) / sum(run.case.tasks for run in runs)
    yield deterministic("tasks that were not done", share, "%")


def _median_percent(pairs: Iterable[tuple[float, float]]) -> float:
    return statistics.median(100.0 * abs(predicted - true) / max(true, CHECK_S) for predicted, true in pairs)
