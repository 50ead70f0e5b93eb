"""Accuracy of maps and positions: teams of several sizes explore floors in lockstep, with exact and slipping wheels.

The same runs can be made with glass and mirrors, and with late messages; these are compared with the runs without.

Each run measures the occupied cells off the walls, the position errors and silent divergence
(`sim/world/arena.py`).
All figures but the wall time depend on the code alone.
"""

import statistics
from collections.abc import Iterable, Iterator
from pathlib import Path

import msgspec

from robrain.deploy.command_line.terminal import print_line
from robrain.lab.bench.figure import Bound, Figure, at_least, at_most, below, deterministic
from robrain.lab.bench.mapping_plan import CONDITIONS, USUAL, WHEELS, BenchPlan, Case, errors_alone, run_all
from robrain.protocol.errors import RobrainError
from robrain.sim.lockstep.result import RunResult

OFF_BOUND_PERCENT = {"exact": 2.0, "slipping": 3.0}
RMSE_BOUND_M = 0.15
SILENT_BOUND_S = 5.0
IN_BAND_BOUND_PERCENT = 95.0
WORSE_BOUND_POINTS = 2.0
"""Largest increase of the share of cells off over the same run under the usual conditions, in percentage points."""
HEADINGS = (
    f"{'map':<24}{'N':>3}{'seed':>6}  {'wheels':<9}{'under':<6}{'sim s':>7}  {'ended':<13}{'explored':>8}{'off %':>8}"
    f"{'doubled m':>11}{'RMSE m':>8}{'max m':>8}{'silent s':>9}{'NEES in %':>10}{'lost':>5}{'wall s':>8}"
)


class MappedRun(msgspec.Struct, frozen=True, kw_only=True):
    """Result of one run; errors and shares are those of the worst robot unless stated otherwise."""

    case: Case
    refusal: str = ""
    """Reason why it could not be run; then the other fields are empty."""
    sim_time_s: float = 0.0
    ended: str = ""
    explored_fraction: float = 0.0
    share_off: float = 0.0
    doubled_walls_m: float = 0.0
    rmse_m: float = 0.0
    max_error_m: float = 0.0
    longest_silent_divergence_s: float = 0.0
    nees_in_band: float | None = None
    """Share over the samples of all robots."""
    nees: float | None = None
    """Mean over all robots' samples, 2 dimensions."""
    lost: int = 0
    """Number of robots that are lost at the end."""
    lost_s: float = 0.0
    """Sum over the robots."""
    collisions: int = 0
    wall_time_s: float = 0.0

    def line(self) -> str:
        """A line for the table below `HEADINGS`."""
        case = self.case
        begin = f"{case.map:<24}{case.robots:>3}{case.seed:>6}  {case.wheels:<9}{case.conditions:<6}"
        if self.refusal:
            return f"{begin}  not run: {self.refusal}"
        in_band = "–" if self.nees_in_band is None else f"{100 * self.nees_in_band:.1f}"
        return (
            f"{begin}{self.sim_time_s:>7.1f}  {self.ended:<13}{self.explored_fraction:>8.1%}"
            f"{100 * self.share_off:>8.2f}{self.doubled_walls_m:>11.1f}{self.rmse_m:>8.3f}{self.max_error_m:>8.2f}"
            f"{self.longest_silent_divergence_s:>9.1f}{in_band:>10}{self.lost:>5}{self.wall_time_s:>8.1f}"
        )


def run_bench(plan: BenchPlan[Case], json_file: Path | None = None) -> None:
    """Execute all runs; print a line for each, and the figures at the end."""
    print_line(HEADINGS)
    run_all("mapping", plan, run_case, _report, figures, json_file)


def _report(runs: list[MappedRun]) -> None:
    if runs[-1].ended == "interrupted":
        raise KeyboardInterrupt
    print_line(runs[-1].line())


def run_case(case: Case) -> MappedRun:
    """Make one run; if it cannot be made, `refusal` gives the reason."""
    try:
        with errors_alone():
            return mapped(case, case.scenario().run(time_limit_s=case.time_limit_s))
    except RobrainError as error:
        return MappedRun(case=case, refusal=str(error))


def mapped(case: Case, result: RunResult) -> MappedRun:
    """Result of a run that was made."""
    accuracies = [robot.pose_accuracy for robot in result.per_robot if robot.pose_accuracy is not None]
    compared = [each for each in accuracies if each.nees_in_band is not None and each.nees is not None]
    samples = sum(each.samples for each in compared)
    of_map = result.map_accuracy
    return MappedRun(
        case=case,
        sim_time_s=result.sim_time_s,
        ended=result.ended,
        explored_fraction=result.explored_fraction,
        share_off=of_map.share_off if of_map is not None else 0.0,
        doubled_walls_m=of_map.doubled_walls_m if of_map is not None else 0.0,
        rmse_m=max((each.rmse_m or 0.0 for each in accuracies), default=0.0),
        max_error_m=max((each.max_error_m or 0.0 for each in accuracies), default=0.0),
        longest_silent_divergence_s=max((each.longest_silent_divergence_s for each in accuracies), default=0.0),
        nees_in_band=sum(each.samples * (each.nees_in_band or 0.0) for each in compared) / samples if samples else None,
        nees=sum(each.samples * (each.nees or 0.0) for each in compared) / samples if samples else None,
        lost=sum(each.is_lost for each in accuracies),
        lost_s=sum(each.lost_s for each in accuracies),
        collisions=result.collisions,
        wall_time_s=result.wall_time_s,
    )


def figures(runs: Iterable[MappedRun]) -> Iterator[Figure]:
    """Worst run and median for each kind of wheels and conditions, with their bounds."""
    made = [run for run in runs if not run.refusal]
    for kind in WHEELS:
        usual = [run for run in made if run.case.wheels == kind and run.case.conditions == USUAL]
        for conditions in CONDITIONS:
            own = [run for run in made if run.case.wheels == kind and run.case.conditions == conditions]
            what = f"{kind} wheels" if conditions == USUAL else f"{kind} wheels, {conditions}"
            if own:
                yield from _figures_of(what, OFF_BOUND_PERCENT[kind], own)
                yield from _compared(what, own, usual)


def _figures_of(what: str, off_bound_percent: float, runs: list[MappedRun]) -> Iterator[Figure]:
    off_bound = at_most(off_bound_percent)
    off = {_name(run): 100 * run.share_off for run in runs}
    yield _worst(f"{what}: occupied cells off, worst run", off, "%", off_bound)
    beside = f"{len(runs)} runs"
    yield deterministic(f"{what}: occupied cells off, median", statistics.median(off.values()), "%", off_bound, beside)
    kept = 100.0 * sum(each <= off_bound_percent for each in off.values()) / len(runs)
    yield deterministic(f"{what}: runs with at most {off_bound_percent:g} % of the cells off", kept, "%", None, beside)
    yield _worst(f"{what}: doubled walls, worst run", {_name(run): run.doubled_walls_m for run in runs}, "m")
    rmse_m = {_name(run): run.rmse_m for run in runs}
    yield _worst(f"{what}: position RMSE, worst robot", rmse_m, "m", at_most(RMSE_BOUND_M))
    median_m = statistics.median(rmse_m.values())
    yield deterministic(f"{what}: position RMSE, worst robot, median run", median_m, "m", at_most(RMSE_BOUND_M))
    yield _worst(f"{what}: position error, largest", {_name(run): run.max_error_m for run in runs}, "m")
    silent_s = {_name(run): run.longest_silent_divergence_s for run in runs}
    yield _worst(f"{what}: silent divergence, longest", silent_s, "s", below(SILENT_BOUND_S))
    in_band = {_name(run): -100 * run.nees_in_band for run in runs if run.nees_in_band is not None}
    if in_band:
        worst = max(in_band, key=in_band.__getitem__)
        least = f"{what}: NEES within its 95 % bound, worst run"
        yield deterministic(least, -in_band[worst], "%", at_least(IN_BAND_BOUND_PERCENT), worst)
    yield _worst(f"{what}: robots lost at the end", {_name(run): float(run.lost) for run in runs}, "")


def _compared(what: str, runs: list[MappedRun], usual: list[MappedRun]) -> Iterator[Figure]:
    """Errors of the maps relative to those of the same runs under the usual conditions."""
    before = {_name(run): run.share_off for run in usual}
    worse = {
        _name(run): 100 * (run.share_off - before[_name(run)])
        for run in runs
        if run.case.conditions != USUAL and _name(run) in before
    }
    if worse:
        bound = at_most(WORSE_BOUND_POINTS)
        yield _worst(f"{what}: occupied cells off, more than usual, worst run", worse, "points", bound)
        beside = f"{len(worse)} runs"
        median = statistics.median(worse.values())
        yield deterministic(f"{what}: occupied cells off, more than usual, median", median, "points", bound, beside)


def _worst(name: str, values: dict[str, float], unit: str, bound: Bound | None = None) -> Figure:
    worst = max(values, key=values.__getitem__)
    return deterministic(name, values[worst], unit, bound, worst)


def _name(run: MappedRun) -> str:
    return f"{run.case.map}, {run.case.robots} robots, seed {run.case.seed}"
