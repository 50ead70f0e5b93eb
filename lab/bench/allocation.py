"""Gaps of task allocation to the best known solutions of public routing instances, beside PyVRP alone."""

import statistics
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec

from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.algorithms.allocation.problem import Objective
from robrain.deploy.command_line.terminal import print_line
from robrain.deploy.errors import UsageError
from robrain.lab.bench.figure import Figure, at_most, timing
from robrain.lab.bench.mapping_plan import BenchPlan, run_all
from robrain.lab.bench.public import PublicResult, read_public, solve_alone, solve_public

BEYOND_PYVRP_PERCENT = at_most(1.0)
SUFFIXES = (".txt", ".vrp")


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
    pyvrp: PublicResult


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
    robrain = solve_public(instance, allocator, deadline_s=case.seconds, seed=case.seed)
    return AllocationRun(
        case=case, robrain=robrain, pyvrp=solve_alone(instance, deadline_s=case.seconds, seed=case.seed)
    )


def _report(runs: list[AllocationRun]) -> None:
    run = runs[-1]
    print_line(f"{run.robrain.instance}: robrain {_words(run.robrain)}; PyVRP alone {_words(run.pyvrp)}")


def _words(result: PublicResult) -> str:
    if result.left_out:
        return result.remark
    gap = "" if result.gap is None else f", gap {100 * result.gap:.2f} %"
    return f"{result.vehicles} vehicles, distance {result.value:.2f}{gap}"


def figures(runs: Sequence[AllocationRun]) -> Iterator[Figure]:
    """Mean gaps in percent, of instances whose customers are all served."""
    gaps = [100 * run.robrain.gap for run in runs if run.robrain.gap is not None]
    served = [run for run in runs if not run.robrain.left_out and not run.pyvrp.left_out]
    beyond = [100 * (run.robrain.value / run.pyvrp.value - 1) for run in served]
    beside = f"{len(runs)} instances, {sum(bool(run.robrain.left_out) for run in runs)} with customers left out"
    if gaps:
        yield timing("gap to the best known values", statistics.mean(gaps), "%", None, beside)
    if beyond:
        alone = f"{sum(bool(run.pyvrp.left_out) for run in runs)} that PyVRP does not solve"
        yield timing("distance beyond PyVRP alone", statistics.mean(beyond), "%", BEYOND_PYVRP_PERCENT, alone)
