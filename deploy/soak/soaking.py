"""The work of `robrain soak`: seeds of fault scripts, run and judged side by side, and the failing ones shrunk."""

import gc
import shlex
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing, nullcontext
from functools import cache
from pathlib import Path

import msgspec

from robrain.deploy.bench.mapping.mapping_plan import errors_alone
from robrain.deploy.run.kernels import prepare_kernels
from robrain.deploy.soak.full_drawing import draw_full_script
from robrain.deploy.soak.full_trial import run_full_trial
from robrain.deploy.soak.planted import BUGS, planted
from robrain.deploy.soak.shrink import TRIALS_MAX, Shrinker
from robrain.deploy.sweep.crew import LocalCrew
from robrain.deploy.sweep.execution import execute_all
from robrain.deploy.sweep.run_outcome import RunState
from robrain.deploy.sweep.worker import is_asked_to_stop
from robrain.sim.lockstep.pacing import StopOnInterrupt
from robrain.sim.stand_in.fault_script import FaultScript, script_json
from robrain.sim.stand_in.judge import Broken
from robrain.sim.stand_in.script_drawing import draw_script
from robrain.sim.stand_in.trial import Verdict, run_trial

SEEDS_AT_ONCE = 4
"""Scripts that are run with a planted bug before it is looked whether one has found it."""


class SoakTask(msgspec.Struct, frozen=True, kw_only=True):
    """What a worker is sent."""

    seed: int
    trials_max: int = TRIALS_MAX
    """Trials to shrink a failing script; 0 leaves it as it is."""
    bug: str = ""
    """Name of a planted bug; empty for the product as it is."""
    is_full: bool = False
    """Whether the script is one for the full stack."""


class SoakRecord(msgspec.Struct, frozen=True, kw_only=True):
    """What came of a seed."""

    seed: int
    state: RunState
    verdict: Verdict | None = None
    script: FaultScript | None = None
    """Of a failing seed: what it was shrunk to."""
    trials: int = 0
    """How often a smaller script was tried."""
    cpu_s: float = 0.0
    """Of the first run, without the shrinking."""
    bug: str = ""
    error: str = ""


class SoakOptions(msgspec.Struct, frozen=True, kw_only=True):
    """How a soak is run."""

    seeds: Sequence[int]
    jobs: int
    minutes: float | None = None
    """No trial begins after this."""
    output: Path
    """Folder for the failing scripts."""
    trials_max: int = TRIALS_MAX
    is_full: bool = False
    """Whether scripts are run with the full stack."""
    quiet: bool = True


class Failure(msgspec.Struct, frozen=True, kw_only=True):
    """A seed whose script breaks an invariant."""

    seed: int
    broken: tuple[Broken, ...]
    faults: int
    """Number of faults of the shrunk script, and of its tasks."""
    tasks: int
    file: Path
    """The shrunk script."""

    @property
    def repeat(self) -> str:
        """The command that runs it again."""
        return shlex.join(("robrain", "soak", "--repeat", str(self.file)))


class SoakResult(msgspec.Struct, kw_only=True):
    """What a soak has found so far."""

    runs: int = 0
    """Trials that have ended, without those that were interrupted."""
    failures: list[Failure] = []
    errors: list[str] = []
    """Trials whose process died."""
    sim_time_s: float = 0.0
    cpu_s: float = 0.0
    wall_time_s: float = 0.0
    tasks_done: int = 0
    lost: int = 0
    """Messages that faults of the wire have lost."""
    faults: dict[str, int] = {}
    """Number of faults by kind."""
    interrupted: bool = False

    @property
    def speed(self) -> float:
        """Simulated time by CPU time."""
        return self.sim_time_s / self.cpu_s if self.cpu_s else 0.0


def draw(seed: int, *, is_full: bool) -> FaultScript:
    """The script of a seed, for the full stack or for the stand-in."""
    return draw_full_script(seed) if is_full else draw_script(seed)


def run_script(script: FaultScript, should_stop: Callable[[], bool] = lambda: False) -> Verdict:
    """Run a script with what it is for, and judge it."""
    return run_full_trial(script, should_stop) if script.scenario else run_trial(script, should_stop)


def soak_one(task: SoakTask) -> SoakRecord:
    """Run the script of a seed, and shrink it if it breaks an invariant; in a worker process."""
    _freeze_code()
    with errors_alone(), planted(task.bug) if task.bug else nullcontext():
        script = draw(task.seed, is_full=task.is_full)
        began_s = time.process_time()
        verdict = run_script(script, is_asked_to_stop)
        cpu_s = time.process_time() - began_s
        if is_asked_to_stop():
            return SoakRecord(seed=task.seed, state=RunState.INTERRUPTED, bug=task.bug)
        if not verdict.broken:
            return SoakRecord(seed=task.seed, state=RunState.DONE, verdict=verdict, cpu_s=cpu_s, bug=task.bug)
        invariant = verdict.broken[0].invariant

        def fails(smaller: FaultScript) -> bool:
            if is_asked_to_stop():
                return False
            return any(one.invariant is invariant for one in run_script(smaller).broken)

        shrinker = Shrinker(fails, task.trials_max)
        shrunk = shrinker.shrink(script) if task.trials_max else script
        return SoakRecord(
            seed=task.seed, state=RunState.DONE, verdict=verdict, script=shrunk, trials=shrinker.trials, cpu_s=cpu_s,
            bug=task.bug,
        )  # fmt: skip


@cache
def _freeze_code() -> None:
    """Have the garbage collector leave out what was loaded so far, in this process: a tenth less time for scripts."""
    gc.collect()
    gc.freeze()


def soak(options: SoakOptions, on_progress: Callable[[SoakResult], None] = lambda _result: None) -> SoakResult:
    """Run all seeds, to the end, to the time limit or to Ctrl-C; write each failing script once it is shrunk."""
    prepare_kernels(quiet=options.quiet)
    result, began_s = SoakResult(), time.monotonic()
    kinds: Counter[str] = Counter()

    def take(record: SoakRecord) -> None:
        if record.state is RunState.INTERRUPTED:
            return
        result.runs += 1
        result.wall_time_s = time.monotonic() - began_s
        if record.verdict is None:
            result.errors.append(f"seed {record.seed}: {record.error}")
        else:
            _add(result, record, record.verdict, options.output)
            kinds.update(fault.kind.value for fault in draw(record.seed, is_full=options.is_full).faults)
            result.faults = dict(kinds.most_common())
        on_progress(result)

    with StopOnInterrupt() as interrupt, closing(_crew(options.jobs)) as crew:

        def should_stop() -> bool:
            is_late = options.minutes is not None and time.monotonic() - began_s > 60.0 * options.minutes
            return interrupt.requested or is_late

        tasks = [SoakTask(seed=seed, trials_max=options.trials_max, is_full=options.is_full) for seed in options.seeds]
        execute_all(tasks, crew, take, without_result, should_stop)
        result.interrupted = interrupt.requested
    result.wall_time_s = time.monotonic() - began_s
    return result


class PlantedFind(msgspec.Struct, frozen=True, kw_only=True):
    """How a planted bug was found, or was not."""

    bug: str
    seed: int | None
    """The first seed that found it; None if none did."""
    seeds: int
    """Number of seeds that were run."""
    wall_time_s: float
    broken: tuple[Broken, ...] = ()


def find_planted(bugs: Sequence[str], seeds: Sequence[int], jobs: int) -> list[PlantedFind]:
    """Run seeds with each planted bug until one finds it; in order of the bugs."""
    prepare_kernels(quiet=True)
    finds: list[PlantedFind] = []
    with StopOnInterrupt() as interrupt, closing(_crew(jobs)) as crew:
        for bug in bugs:
            if not interrupt.requested:
                finds.append(_find(bug, seeds, crew, lambda: interrupt.requested))
    return finds


def _find(
    bug: str, seeds: Sequence[int], crew: LocalCrew[SoakTask, SoakRecord], should_stop: Callable[[], bool]
) -> PlantedFind:
    """In chunks, so that few scripts are run needlessly once one has found the bug."""
    began_s, records = time.monotonic(), list[SoakRecord]()
    for start in range(0, len(seeds), SEEDS_AT_ONCE):
        tasks = [SoakTask(seed=seed, trials_max=0, bug=bug) for seed in seeds[start : start + SEEDS_AT_ONCE]]
        execute_all(tasks, crew, records.append, without_result, should_stop)
        found = [record for record in records if record.verdict is not None and record.verdict.broken]
        if found or should_stop():
            break
    first = min(found, key=lambda record: record.seed, default=None) if records else None
    return PlantedFind(
        bug=bug,
        seed=None if first is None else first.seed,
        seeds=len(records),
        wall_time_s=round(time.monotonic() - began_s, 1),
        broken=() if first is None or first.verdict is None else first.verdict.broken,
    )


def without_result(task: SoakTask, state: RunState, why: str) -> SoakRecord:
    """The record of a trial that ended without one."""
    return SoakRecord(seed=task.seed, state=state, error=why, bug=task.bug)


def known_bugs() -> list[str]:
    """Names of the planted bugs, in the order of their table."""
    return list(BUGS)


def _crew(jobs: int) -> LocalCrew[SoakTask, SoakRecord]:
    return LocalCrew(jobs, soak_one)


def _add(result: SoakResult, record: SoakRecord, verdict: Verdict, output: Path) -> None:
    result.sim_time_s += verdict.sim_time_s
    result.cpu_s += record.cpu_s
    result.tasks_done += verdict.done
    result.lost += verdict.lost
    if record.script is None:
        return
    output.mkdir(parents=True, exist_ok=True)
    file = output / f"seed-{record.seed}.json"
    file.write_bytes(script_json(record.script))
    result.failures.append(
        Failure(
            seed=record.seed,
            broken=verdict.broken,
            faults=len(record.script.faults) + len(record.script.halts),
            tasks=len(record.script.tasks),
            file=file,
        )
    )
