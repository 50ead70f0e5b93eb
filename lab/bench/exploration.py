"""Exploration by strategies, team sizes and floors: full runs and runs of points side by side."""

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from rich.table import Table

from robrain.algorithms.exploration.strategies import STRATEGIES
from robrain.algorithms.mapping.ray_cast import cast_rays_of
from robrain.algorithms.navigation.clearance import least_clearance_m
from robrain.algorithms.navigation.path_planning import distance_field
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.deploy.command_line.terminal import print_line
from robrain.deploy.errors import UsageError
from robrain.lab.bench.figure import Figure, at_most, deterministic
from robrain.lab.bench.mapping_plan import (
    BenchPlan,
    check_limits,
    choose_maps,
    errors_alone,
    interval_words,
    mean_words,
    names_of,
    numbers_of,
    run_all,
)
from robrain.plugins.unit.driver.driver import Driver
from robrain.protocol.errors import RobrainError
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.registry import UnknownEntry
from robrain.sim.errors import RunFailed
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.maps.placement import Starts
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.scenarios.scenario_file import MAX_ROBOTS, MAX_SEED
from robrain.sim.world.time_use import TimeUse
from robrain.sim.world.world import Fidelity

STANDPOINT_M = 0.4
"""Distance between the places from which is looked."""
RAYS = 720
"""At 6 m they are 5 cm apart, the pitch of the finest maps."""
PERCENTILE = 95.0
NOBODY = np.empty((0, 3))
FULL, POINTS = Fidelity.FULL.value, Fidelity.POINTS.value
MOTIONS = (FULL, POINTS)
"""Fidelities of the runs."""
SPEED_M_S = Driver.Parameters().speed_m_s
"""Top speed."""
UNTIL = 0.99
JUDGED_PERCENT = 95
"""The share whose time is compared with the bounds."""
SPEED_UPS = {2: 1.6, 4: 3.2, 8: 6.4}
"""Least speed-up over the best strategy with one robot, by number of robots, unless the floor bounds the time."""
OVER_BOUND = 1.5
"""Factor on the floor's bound within which a speed-up is not asked for."""
OVER_POINTS = {1: 1.15, 4: 1.25}
"""Largest time over that of points, by number of robots."""
OVER_BEST = 1.03
"""Largest time of the default strategy over that of the best."""
WIDTH = 178


def sight_bound_s(plan: FloorPlan, start: Point2D, radius_m: float, range_m: float, speed_m_s: float) -> float:
    """The least time in which robots from `start`, however many there are, can have seen 95 % of the floor, in seconds.

    A place is seen first from the point with the shortest path among all points with it in sight and in range. The
    bound is the 95th percentile of these path lengths over the floor, at top speed. Half a diagonal between standpoints
    is taken off.

    Args:
        plan: the floor.
        start: start of the team, arena frame.
        radius_m: of each robot.
        range_m: of the lidars.
        speed_m_s: top speed.

    """
    reachable, away_m = _away_m(plan, start, radius_m)
    step = max(1, round(STANDPOINT_M / plan.resolution_m))
    rows, columns = np.nonzero(np.isfinite(away_m[::step, ::step]) & reachable[::step, ::step])
    seen_m = _seen_m(plan, np.stack([rows * step, columns * step], axis=1), away_m, range_m)
    return max(0.0, _farthest_m(seen_m[reachable]) - STANDPOINT_M / math.sqrt(2.0)) / speed_m_s


def _farthest_m(lengths_m: Floats) -> float:
    """The path length within which is 95 % of the floor that can be reached."""
    return float(np.percentile(lengths_m[np.isfinite(lengths_m)], PERCENTILE))


def _away_m(plan: FloorPlan, start: Point2D, radius_m: float) -> tuple[np.ndarray, Floats]:
    """Whether robots can stand at each cell, and the length of the path to it, metres; both (rows, columns)."""
    reachable = plan.reachable([start], least_clearance_m(radius_m))
    at = np.array([plan.geometry.cell_of(start.x_m, start.y_m)], dtype=np.int64)
    field = distance_field(reachable, np.ones(reachable.shape, np.float32), at)
    return reachable, field.astype(np.float64) * plan.resolution_m


def _seen_m(plan: FloorPlan, cells: np.ndarray, away_m: Floats, range_m: float) -> Floats:
    """Length of the shortest path to one of the cells that sees a cell, (rows, columns), metres; inf if none does."""
    geometry = plan.geometry
    walls = plan.occupied.copy()  # writable: a read-only array would be copied for every ray
    angles_rad = np.linspace(-math.pi, math.pi, RAYS, endpoint=False)
    along_m = np.arange(0.0, range_m, 0.7 * plan.resolution_m)
    x_m = along_m * np.cos(angles_rad)[:, np.newaxis]
    y_m = along_m * np.sin(angles_rad)[:, np.newaxis]
    seen_m = np.full(geometry.shape, np.inf)
    for row, column in cells.tolist():
        place = geometry.center_of(row, column)
        ranges_m = cast_rays_of(walls, geometry, Pose2D(place.x_m, place.y_m, 0.0), angles_rad, range_m, NOBODY)
        is_seen = along_m < np.minimum(ranges_m, range_m)[:, np.newaxis]
        rows = ((place.y_m + y_m[is_seen] - plan.origin_y_m) / plan.resolution_m).astype(np.int64)
        columns = ((place.x_m + x_m[is_seen] - plan.origin_x_m) / plan.resolution_m).astype(np.int64)
        is_inside = (rows >= 0) & (rows < geometry.height) & (columns >= 0) & (columns < geometry.width)
        rows, columns = rows[is_inside], columns[is_inside]
        seen_m[rows, columns] = np.minimum(seen_m[rows, columns], away_m[row, column])
    return seen_m


class ExplorationCase(msgspec.Struct, frozen=True, kw_only=True):
    """One run."""

    map: str
    path: str
    """Path of the map's YAML file; empty for a built-in scenario."""
    robots: int
    seed: int
    strategy: str
    motion: str
    """Of `MOTIONS`."""
    near: tuple[float, float] | None = None
    """Around which place the robots start, metres, arena frame; None: where the scenario has it, the same place for
    teams of all sizes."""
    time_limit_s: float = 900.0
    with_sight: bool = False
    """Whether `sight_s` is computed, which needs some seconds."""

    def scenario(self) -> Scenario:
        """The scenario of the run (RobrainError if the map cannot be read)."""
        found = Scenario.from_map(self.path) if self.path else Scenario.builtin(self.map)
        policy = msgspec.structs.replace(found.planning, exploration=self.strategy)
        changes: dict[str, object] = {"planning": policy, "until_explored": UNTIL, "time_limit_s": self.time_limit_s}
        if self.near is not None:
            changes["near"] = Point2D(*self.near)
        return found.replace(
            robots=self.robots, seed=self.seed, starts=Starts.TOGETHER, fidelity=self.motion, **changes
        )


class ExplorationRun(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a run."""

    case: ExplorationCase
    refusal: str = ""
    """Reason why it could not be run; then the other fields are empty."""
    explored_percent_s: dict[int, float] = {}
    """Simulated time at which 90, 95 and 99 % were known, without shares that were not reached."""
    explored_fraction: float = 0.0
    sim_time_s: float = 0.0
    bound_s: float = 0.0
    """No team can know 95 % before: `bound_s`."""
    sight_s: float | None = None
    """No team can have seen 95 % before, even with the map of the floor: `sight_bound_s`; None unless requested."""
    distance_m: float = 0.0
    energy_j: float = 0.0
    explored_m2: float = 0.0
    overlap: float = 0.0
    collisions: int = 0
    time_use: TimeUse = TimeUse()
    """Summed over the robots."""


def run_case(case: ExplorationCase) -> ExplorationRun:
    """Make one run; if it cannot be made, `refusal` gives the reason (RunFailed if its strategy fails)."""
    try:
        with errors_alone():
            return _made(case)
    except RunFailed:
        raise
    except RobrainError as error:
        return ExplorationRun(case=case, refusal=str(error))


def bound_s(plan: FloorPlan, start: Point2D, radius_m: float, range_m: float, speed_m_s: float = SPEED_M_S) -> float:
    """The least time in which a team from `start` can know 95 % of the floor, in seconds.

    A robot must come within the lidar's range of a place that is farther away by path than 95 % of the floor. The bound
    is the 95th percentile of the path lengths less the range, at top speed.

    Args:
        plan: the floor.
        start: start of the team, arena frame.
        radius_m: of each robot.
        range_m: of the lidars.
        speed_m_s: top speed.

    """
    reachable, away_m = _away_m(plan, start, radius_m)
    return max(0.0, _farthest_m(away_m[reachable]) - range_m) / speed_m_s


def _made(case: ExplorationCase) -> ExplorationRun:
    scenario = case.scenario()
    result = scenario.run()
    spent = [robot.time_use for robot in result.per_robot]
    world, radius_m, range_m = scenario.world(), scenario.hardware.radius_m, scenario.hardware.lidar.range_max_m
    plan, starts = world.plan, [Point2D(robot.start.x_m, robot.start.y_m) for robot in world.robots]
    area_m2 = float(plan.reachable(starts, least_clearance_m(radius_m)).sum()) * plan.resolution_m**2
    return ExplorationRun(
        case=case,
        explored_percent_s=result.explored_percent_s,
        explored_fraction=result.explored_fraction,
        sim_time_s=result.sim_time_s,
        bound_s=bound_s(plan, starts[0], radius_m, range_m),
        sight_s=sight_bound_s(plan, starts[0], radius_m, range_m, SPEED_M_S) if case.with_sight else None,
        distance_m=result.distance_m,
        energy_j=result.energy_j,
        explored_m2=result.explored_fraction * area_m2,
        overlap=result.overlap,
        collisions=result.collisions,
        time_use=TimeUse(**{name: sum(getattr(one, name) for one in spent) for name in TimeUse.__struct_fields__}),
    )


class Group(NamedTuple):
    """Runs that differ by their seed alone."""

    map: str
    robots: int
    strategy: str
    motion: str


def choose(
    maps: str | None,
    robots: str,
    seeds: str,
    strategies: str | None,
    motions: str,
    near: tuple[float, float] | None,
    jobs: int,
    time_limit_s: float,
    map_folder: Path | None = None,
    *,
    with_sight: bool = False,
) -> BenchPlan[ExplorationCase]:
    """Make a plan from the options: each map with each number of robots, strategy, motion and seed.

    Raises:
        UsageError: an option is wrong; the text names it and the expected value.

    """
    chosen, absent = choose_maps(maps, map_folder)
    names = STRATEGIES.names if strategies is None else names_of("--strategies", strategies)
    for name in names:
        try:
            STRATEGIES.get(name)
        except UnknownEntry as error:
            raise UsageError(f"--strategies {name}: {error}") from error
    moves = names_of("--motion", motions, MOTIONS)
    counts = numbers_of("--robots", robots, 1, MAX_ROBOTS)
    drawn = numbers_of("--seeds", seeds, 0, MAX_SEED)
    check_limits(jobs, time_limit_s)
    cases = [
        ExplorationCase(
            map=name,
            path=path,
            robots=count,
            seed=seed,
            strategy=strategy,
            motion=motion,
            near=near,
            time_limit_s=time_limit_s,
            with_sight=with_sight,
        )
        for name, path in chosen.items()
        for count in counts
        for motion in moves
        for strategy in names
        for seed in drawn
    ]
    return BenchPlan(cases=cases, jobs=jobs, absent=absent)


def run_bench(plan: BenchPlan[ExplorationCase], json_file: Path | None = None) -> None:
    """Execute all runs; print a line for each group of seeds, and the figures at the end."""

    def report(runs: list[ExplorationRun]) -> None:
        run = runs[-1]
        if run.refusal:
            print_line(f"{_text_of(_group_of(run))}, seed {run.case.seed}: not run: {run.refusal}")
        if len(runs) == len(plan.cases) or _group_of(run) != _key(plan.cases[len(runs)]):
            made = [one for one in runs if _group_of(one) == _group_of(run) and not one.refusal]
            print_line(f"{_text_of(_group_of(run))}: {_percents(made)}")

    run_all("exploration", plan, run_case, report, figures, json_file, table=table, width=WIDTH)


def table(runs: Sequence[ExplorationRun]) -> Table:
    """Means over the seeds, with their 95 % intervals where runs are judged; a row for each group."""
    title = "Exploration: means over the seeds [95 % interval]; drive to stand are shares of the robots' time in %"
    shown = Table(title=title, title_justify="left")
    for heading in ("map", "motion", "strategy"):
        shown.add_column(heading, no_wrap=True)
    headings = ("N", "runs", "90 % s", "95 % s", "99 % s", "bound s", "sight s", "speed-up", "overlap", "m", "J/m²")
    for heading in (*headings, "drive", "turn", "wait", "stand", "hits"):
        shown.add_column(heading, justify="right", no_wrap=True)
    groups = by_group(runs)
    for group, made in groups.items():
        one = _mean_s(groups.get(group._replace(robots=1), []))
        own = _mean_s(made)
        speed_up = "–" if one is None or not own else f"{one / own:.2f}"
        spent = [run.time_use for run in made]
        total_s = sum(sum(msgspec.structs.astuple(each)) for each in spent) or 1.0
        shares = [
            f"{100 * sum(getattr(each, name) for each in spent) / total_s:.0f}" for name in spent[0].__struct_fields__
        ]
        shown.add_row(
            group.map,
            group.motion,
            group.strategy,
            str(group.robots),
            str(len(made)),
            mean_words(_times(made, 90), 1),
            interval_words(_times(made, JUDGED_PERCENT), 1),
            mean_words(_times(made, 99), 1),
            f"{sum(run.bound_s for run in made) / len(made):.1f}",
            mean_words([run.sight_s for run in made], 1),
            speed_up,
            mean_words([run.overlap for run in made], 2),
            mean_words([run.distance_m for run in made], 0),
            mean_words([run.energy_j / run.explored_m2 for run in made], 1),
            *shares,
            str(sum(run.collisions for run in made)),
        )
    return shown


def figures(runs: Sequence[ExplorationRun]) -> Iterator[Figure]:
    """The default strategy's times of the full stack beside one robot's, the points', and the best strategy's."""
    groups = by_group(runs)
    default = PlanningPolicy().exploration
    for group, made in groups.items():
        if group.motion != FULL or group.strategy != default:
            continue
        name, own = f"{group.map}, {group.robots} robots", _mean_s(made)
        alike = {other.strategy: found for other, found in groups.items() if other._replace(strategy=default) == group}
        alone = [
            _mean_s(found) for other, found in groups.items() if other[:2] == (group.map, 1) and other.motion == FULL
        ]
        least_s = min((each for each in alone if each is not None), default=None)
        if (wanted := SPEED_UPS.get(group.robots)) is not None and least_s is not None:
            floor_s = OVER_BOUND * sum(run.bound_s for run in made) / len(made)
            bound = at_most(round(max(least_s / wanted, floor_s), 2))
            yield deterministic(f"{name}: {JUDGED_PERCENT} % known", math.nan if own is None else own, "s", bound=bound)
        points_s = _mean_s(groups.get(group._replace(motion=POINTS), []))
        if points_s and own:
            over = OVER_POINTS.get(group.robots)
            limit = None if over is None else at_most(over)
            yield deterministic(f"{name}: time over that of points", own / points_s, "×", bound=limit)
        times = {strategy: time_s for strategy, found in alike.items() if (time_s := _mean_s(found)) is not None}
        if len(times) > 1 and own:
            best = min(times, key=times.__getitem__)
            ratio, bound = own / times[best], at_most(OVER_BEST)
            yield deterministic(f"{name}: time over the best", ratio, "×", bound, f"best: {best}")


def by_group(runs: Iterable[ExplorationRun]) -> dict[Group, list[ExplorationRun]]:
    """The runs that could be made, grouped by all properties but the seed."""
    groups: dict[Group, list[ExplorationRun]] = {}
    for run in runs:
        if not run.refusal:
            groups.setdefault(_group_of(run), []).append(run)
    return groups


def _key(case: ExplorationCase) -> Group:
    return Group(case.map, case.robots, case.strategy, case.motion)


def _group_of(run: ExplorationRun) -> Group:
    return _key(run.case)


def _text_of(group: Group) -> str:
    return f"{group.map}, {group.robots} robots, {group.strategy}, {group.motion}"


def _percents(runs: Sequence[ExplorationRun]) -> str:
    return ", ".join(f"{percent} % after {interval_words(_times(runs, percent), 1)} s" for percent in (90, 95, 99))


def _times(runs: Iterable[ExplorationRun], percent: int) -> list[float | None]:
    return [run.explored_percent_s.get(percent) for run in runs]


def _mean_s(runs: Sequence[ExplorationRun]) -> float | None:
    """Mean time of `JUDGED_PERCENT`; None if there is no run, or one did not come so far."""
    times = _times(runs, JUDGED_PERCENT)
    known = [time_s for time_s in times if time_s is not None]
    return sum(known) / len(known) if known and len(known) == len(times) else None
