"""Exploration whose coordinator is killed on the way, beside the same exploration undisturbed."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from robrain.algorithms.navigation.clearance import least_clearance_m
from robrain.deploy.command_line.terminal import new_console, print_line
from robrain.deploy.errors import UsageError
from robrain.deploy.run.kernels import prepare_kernels
from robrain.lab.bench.figure import Figure, are_kept, at_most, deterministic, show_figures, write_json
from robrain.lab.bench.mapping_plan import all_runs, check_limits, choose_maps, errors_alone, numbers_of
from robrain.protocol.model.geometry import Point2D
from robrain.sim.lockstep.lockstep import LockstepRun
from robrain.sim.maps.placement import Starts
from robrain.sim.scenarios.scenario import MAX_SEED, Scenario
from robrain.sim.scenarios.scenario_file import MAX_ROBOTS
from robrain.sim.world.referee import floor_weights

KNOWN = 0.95
"""Share of the floor at which a run ends."""
KILLED_AT = 0.3
"""Share of the floor that is known when the coordinator is killed."""
LOOK_S = 1.0
"""Period in which each robot's own map is looked at."""


class LeaderlessCase(msgspec.Struct, frozen=True, kw_only=True):
    """One run."""

    map: str
    path: str = ""
    """Path of the map's YAML file; empty for a built-in scenario."""
    robots: int
    seed: int
    consensus: bool = True
    """Whether robots may go on without a coordinator."""
    killed_at: float | None = KILLED_AT
    """Share of the floor that is known when the coordinator is killed; None leaves it alone."""
    time_limit_s: float = 900.0

    def scenario(self) -> Scenario:
        """The scenario of the run (RobrainError if the map cannot be read)."""
        found = Scenario.from_map(self.path) if self.path else Scenario.builtin(self.map)
        hardware = msgspec.structs.replace(found.hardware, consensus=self.consensus)
        return found.replace(
            robots=self.robots, seed=self.seed, starts=Starts.TOGETHER, motes=0, hardware=hardware, tasks=()
        )


class LeaderlessRun(msgspec.Struct, frozen=True, kw_only=True):
    """What a run took."""

    case: LeaderlessCase
    team_s: float
    """When all robots together knew 95 % of the floor, in simulated seconds; inf if they never did."""
    last_s: float
    """When each of them did by its own map."""
    killed_s: float = math.inf
    known: float = 0.0
    """Share of the floor that was known in the end."""
    collisions: int = 0


def run_case(case: LeaderlessCase) -> LeaderlessRun:
    """Explore until every robot knows 95 % of the floor by its own map, or time is up."""
    scenario = case.scenario()
    with errors_alone():
        run = LockstepRun(scenario.world(), planning=scenario.planning)
        try:
            return _explore(run, case)
        finally:
            run.close()


def _explore(run: LockstepRun, case: LeaderlessCase) -> LeaderlessRun:
    weights = _weights(run)
    team_s = last_s = killed_s = math.inf
    look_s = 0.0
    while run.sim_time_s < case.time_limit_s and last_s == math.inf:
        run.tick()
        known, now_s = run.explored_fraction, run.sim_time_s
        if case.killed_at is not None and killed_s == math.inf and known >= case.killed_at:
            killed_s = now_s
            run.end_coordinator()
        if known >= KNOWN and team_s == math.inf:
            team_s = now_s
        if team_s < math.inf and now_s >= look_s:
            look_s = now_s + LOOK_S
            if all(_known_by(run, robot, weights) >= KNOWN for robot in range(len(run.hosts))):
                last_s = now_s
    return LeaderlessRun(
        case=case,
        team_s=team_s,
        last_s=last_s,
        killed_s=killed_s,
        known=run.explored_fraction,
        collisions=run.arena.collisions,
    )


def _weights(run: LockstepRun) -> NDArray[np.int64]:
    """What each cell of the team's grid counts."""
    world = run.world
    starts = [Point2D(robot.start.x_m, robot.start.y_m) for robot in world.robots]
    clearance_m = least_clearance_m(min(robot.radius_m for robot in world.robots))
    return floor_weights(world.plan, starts, clearance_m, run.arena.referee.grid.geometry)


def _known_by(run: LockstepRun, robot: int, weights: NDArray[np.int64]) -> float:
    """Share of the floor that a robot knows by its own map."""
    grid = run.hosts[robot].board.map
    return 0.0 if grid is None else float(weights[grid.classes() >= 0].sum() / weights.sum())


OVER_UNDISTURBED = 1.25
"""Largest mean time without a coordinator over the mean time with one."""
WIDTH = 110


class LeaderlessReport(msgspec.Struct, frozen=True, kw_only=True):
    """Contents of the file of `--json`. Times that were not reached are null."""

    bench: str
    runs: list[LeaderlessRun]
    figures: list[Figure]
    all_kept: bool


def choose(
    maps: str, robots: str, seeds: str, killed_at_percent: float, time_limit_s: float, map_folder: Path | None = None
) -> list[LeaderlessCase]:
    """The runs that the options ask for: each undisturbed, then with the coordinator killed.

    Raises:
        UsageError: an option is wrong; the text names it and what was expected.

    """
    if not 0 < killed_at_percent < 100 * KNOWN:
        raise UsageError(f"--killed-at {killed_at_percent:g}: expected a percentage above 0 and below {100 * KNOWN:g}")
    check_limits(1, time_limit_s)
    chosen, _ = choose_maps(maps, map_folder)
    return [
        LeaderlessCase(map=name, path=path, robots=count, seed=seed, killed_at=killed_at, time_limit_s=time_limit_s)
        for name, path in chosen.items()
        for count in numbers_of("--robots", robots, 1, MAX_ROBOTS)
        for seed in numbers_of("--seeds", seeds, 0, MAX_SEED)
        for killed_at in (None, killed_at_percent / 100)
    ]


def run_bench(cases: Sequence[LeaderlessCase], jobs: int, json_file: Path | None = None) -> None:
    """Make all runs; prints a line for each, and the figures at the end.

    Args:
        cases: the runs.
        jobs: number of runs at a time.
        json_file: written after each run, so that what was measured is kept if the benchmark is interrupted.

    Raises:
        UsageError: `json_file` cannot be written, or `jobs` is less than 1.

    """
    check_limits(jobs, 1.0)
    _write(json_file, [])
    prepare_kernels()
    runs: list[LeaderlessRun] = []
    for run in all_runs(run_case, cases, jobs):
        runs.append(run)
        print_line(_text_of(run))
        _write(json_file, runs)
    console = new_console(width=WIDTH)
    console.print(table(runs))
    show_figures("exploration without a coordinator, each figure beside its bound", figures(runs), console)


def table(runs: Sequence[LeaderlessRun]) -> Table:
    """A row for each seed: with and without the coordinator."""
    title = f"Seconds until the team knew {KNOWN:.0%} of the floor, and until each robot did by its own map"
    shown = Table(title=title, title_justify="left")
    shown.add_column("map", no_wrap=True)
    headings = ("robots", "seed", "undisturbed s", "each s", "killed at s", "without s", "each s", "ratio", "hits")
    for heading in headings:
        shown.add_column(heading, justify="right", no_wrap=True)
    for calm, killed in pairs(runs):
        case = calm.case
        cells = [calm.team_s, calm.last_s, killed.killed_s, killed.team_s, killed.last_s]
        ratio = killed.team_s / calm.team_s
        words = [f"{cell:.0f}" if math.isfinite(cell) else "–" for cell in cells]
        hits = f"{calm.collisions}, {killed.collisions}"
        shown.add_row(case.map, str(case.robots), str(case.seed), *words, f"{ratio:.2f}", hits)
    return shown


def pairs(runs: Sequence[LeaderlessRun]) -> list[tuple[LeaderlessRun, LeaderlessRun]]:
    """Each undisturbed run with the one whose coordinator was killed."""
    found = {msgspec.structs.replace(run.case, killed_at=None): run for run in runs if run.case.killed_at is not None}
    return [(run, found[run.case]) for run in runs if run.case.killed_at is None and run.case in found]


def figures(runs: Sequence[LeaderlessRun]) -> Iterator[Figure]:
    """The ratio of mean times for each map and number of robots, and the collisions of all runs."""
    groups: dict[tuple[str, int], list[tuple[LeaderlessRun, LeaderlessRun]]] = {}
    for calm, killed in pairs(runs):
        groups.setdefault((calm.case.map, calm.case.robots), []).append((calm, killed))
    for (name, robots), made in groups.items():
        calm_s = math.fsum(calm.team_s for calm, _ in made) / len(made)
        killed_s = math.fsum(killed.team_s for _, killed in made) / len(made)
        beside = f"{calm_s:.0f} s undisturbed, {killed_s:.0f} s without, {len(made)} seeds"
        what = f"{name}, {robots} robots: time without a coordinator over undisturbed"
        yield deterministic(what, killed_s / calm_s, bound=at_most(OVER_UNDISTURBED), beside=beside)
    hits = sum(run.collisions for run in runs)
    yield deterministic("collisions in all runs", hits, bound=at_most(0), beside=f"{len(runs)} runs")


def _text_of(run: LeaderlessRun) -> str:
    case = run.case
    how = "undisturbed" if case.killed_at is None else f"coordinator killed at {case.killed_at:.0%}"
    when = f"{KNOWN:.0%} known after {run.team_s:.0f} s" if math.isfinite(run.team_s) else f"{run.known:.0%} known"
    return f"{case.map}, {case.robots} robots, seed {case.seed}, {how}: {when}"


def _write(json_file: Path | None, runs: list[LeaderlessRun]) -> None:
    if json_file is not None:
        found = list(figures(runs))
        write_json(json_file, LeaderlessReport(bench="leaderless", runs=runs, figures=found, all_kept=are_kept(found)))
