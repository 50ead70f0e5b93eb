"""The runs of a benchmark: chosen from their options, made one by one or side by side, and reported."""

import logging
import multiprocessing
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Generic, TypeVar

import msgspec
from rich.table import Table

from robrain.deploy.command_line.terminal import new_console, print_progress
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.kernels import prepare_kernels
from robrain.lab.bench.figure import WIDTH, Figure, show_figures, write_json
from robrain.lab.report.mean_interval import mean_interval
from robrain.sim.firmware.disturbance import DelaySpec, DisturbanceSpec, FrameDelaySpec, PauseSpec
from robrain.sim.maps.surfaces import SurfaceSpec
from robrain.sim.robot.wheels import WheelSpec
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.scenarios.scenario_file import MAX_ROBOTS, MAX_SEED, builtin_names

PROJECT = Path(__file__).resolve().parents[2]
OWN_MAPS = PROJECT / "examples" / "maps"
SHARED_MAPS = PROJECT.parent / "shared" / "maps"
SHARED_NAMES = ("stage_cave", "stage_hospital_section", "stage_autolab", "nav2_depot")
"""Maps of public repositories; not part of the project."""
BUILT_IN = ("arena_small", "depot")
"""Built-in scenarios that are run by default; others are run if they are named."""
WHEELS = {
    "exact": None,
    "slipping": WheelSpec(radius_sigma=0.01, base_sigma=0.01, slip=0.01, slip_sigma_m_per_sqrt_m=0.01),
}
"""Wheels by name; None keeps the scenario's."""
USUAL, GLASS, LATE = "usual", "glass", "late"
CONDITIONS = (USUAL, GLASS, LATE)
"""All have noise and dropouts of the lidar.

Glass: stretches of glass and mirrors among the walls. Late: frames and scans are late and come in bursts, agents pause.
"""
DROPOUT = 0.01
"""Share of the lidar's beams."""
GLASS_WALLS = SurfaceSpec(glass_share=0.1, mirror_share=0.02)
LATE_MESSAGES = DisturbanceSpec(
    can=FrameDelaySpec(per_minute=6.0, duration_s=(0.1, 0.35), late_s=(0.0, 0.01)),
    scan=DelaySpec(per_minute=6.0, duration_s=(0.2, 1.0), late_s=(0.0, 0.3)),
    agent=PauseSpec(per_minute=6.0, duration_s=(0.2, 1.5)),
)
NUMBERS_MAX = 1000

Asked = TypeVar("Asked")
Made = TypeVar("Made")


class Case(msgspec.Struct, frozen=True, kw_only=True):
    """One run of the benchmark."""

    map: str
    path: str
    """Path of the map's YAML file; empty for a built-in scenario."""
    robots: int
    seed: int
    wheels: str
    time_limit_s: float
    conditions: str = USUAL
    """Of `CONDITIONS`."""

    def scenario(self) -> Scenario:
        """The scenario of the run (ScenarioError if the map cannot be read)."""
        found = Scenario.from_map(self.path) if self.path else Scenario.builtin(self.map)
        hardware = found.hardware
        lidar = msgspec.structs.replace(hardware.lidar, dropout=DROPOUT)
        wheels = WHEELS[self.wheels]
        hardware = msgspec.structs.replace(hardware, lidar=lidar, wheels=hardware.wheels if wheels is None else wheels)
        if self.conditions == GLASS:
            found = found.replace(surfaces=GLASS_WALLS)
        elif self.conditions == LATE:
            found = found.replace(disturbance=LATE_MESSAGES)
        return found.replace(robots=self.robots, seed=self.seed, hardware=hardware)


class BenchPlan(msgspec.Struct, Generic[Asked], frozen=True, kw_only=True):
    """All runs of a benchmark."""

    cases: list[Asked]
    jobs: int
    absent: list[str] = []
    """Default maps that are not on this computer."""


def choose(
    maps: str | None,
    robots: str,
    seeds: str,
    wheels: str,
    jobs: int,
    time_limit_s: float,
    map_folder: Path | None = None,
    conditions: str = USUAL,
) -> BenchPlan[Case]:
    """Make a plan from the options: each map with each number of robots, seed, kind of wheels and conditions.

    Raises:
        UsageError: an option is wrong; the text names it and the expected value.

    """
    chosen, absent = choose_maps(maps, map_folder)
    kinds = names_of("--wheels", wheels, WHEELS)
    under = names_of("--conditions", conditions, CONDITIONS)
    counts = numbers_of("--robots", robots, 1, MAX_ROBOTS)
    drawn = numbers_of("--seeds", seeds, 0, MAX_SEED)
    check_limits(jobs, time_limit_s)
    cases = [
        Case(map=name, path=path, robots=count, seed=seed, wheels=kind, time_limit_s=time_limit_s, conditions=one)
        for name, path in chosen.items()
        for count in counts
        for kind in kinds
        for seed in drawn
        for one in under
    ]
    return BenchPlan(cases=cases, jobs=jobs, absent=absent)


def check_limits(jobs: int, time_limit_s: float) -> None:
    """Check `--jobs` and `--time-limit-s` (UsageError if one is not above 0)."""
    if jobs < 1:
        raise UsageError(f"--jobs {jobs}: expected at least 1")
    if not 0 < time_limit_s < float("inf"):
        raise UsageError(f"--time-limit-s {time_limit_s:g}: expected a number above 0")


def choose_maps(maps: str | None, map_folder: Path | None) -> tuple[dict[str, str], list[str]]:
    """Path of each chosen map by name, empty for built-in scenarios; and default maps that are not on this computer.

    Raises:
        UsageError: there is no such folder or map.

    """
    if map_folder is not None and not map_folder.is_dir():
        raise UsageError(f"--map-folder {map_folder}: expected an existing folder of map_server files")
    known, absent = _known_maps(map_folder or SHARED_MAPS)
    names = (
        [name for name, path in known.items() if path or name in BUILT_IN] if maps is None else _words("--maps", maps)
    )
    chosen = {name: path for word in names for name, path in [_map_of(word, known, absent)]}
    return chosen, absent if maps is None else []


def all_runs(run: Callable[[Asked], Made], asked: Sequence[Asked], jobs: int) -> Iterator[Made]:
    """Results of the runs, in order; with several jobs the runs are in separate processes."""
    if jobs == 1:
        yield from map(run, asked)
        return
    # Forked processes would share the locks of Zenoh's threads.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        try:
            yield from pool.map(run, asked)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def run_all(
    bench: str,
    plan: BenchPlan[Asked],
    run: Callable[[Asked], Made],
    report: Callable[[list[Made]], None],
    figures: Callable[[list[Made]], Iterable[Figure]],
    json_file: Path | None = None,
    *,
    table: Callable[[list[Made]], Table] | None = None,
    width: int = WIDTH,
) -> None:
    """Execute all runs of a benchmark, and print its table and figures at the end.

    Args:
        bench: its name.
        plan: the runs.
        run: makes one.
        report: called with all runs so far after each of them; prints what is new.
        figures: figures of runs.
        json_file: written after each run, so that results are kept if the benchmark is interrupted.
        table: table of the runs, if there is one.
        width: of the output, in characters.

    Raises:
        OSError: `json_file` cannot be written.

    """
    write_json(json_file, bench, [], [])
    for name in plan.absent:
        print_progress(f"{name}: left out, it is not in {SHARED_MAPS} (see --map-folder)")
    prepare_kernels()
    runs: list[Made] = []
    for made in all_runs(run, plan.cases, plan.jobs):
        runs.append(made)
        report(runs)
        write_json(json_file, bench, runs, figures(runs))
    console = new_console(width=width)
    if table is not None:
        console.print(table(runs))
    if found := list(figures(runs)):
        show_figures(f"{bench}, each figure beside the bound that it is to keep", found, console)


def interval_words(values: Sequence[float | None], decimals: int) -> str:
    """`35.1 [33.2, 37.5]`; with `(8 of 10)` if some values are missing, and a dash if all are."""
    mean = mean_interval([value for value in values if value is not None])
    return "–" if mean is None else mean.words(decimals) + _of(values)


def mean_words(values: Sequence[float | None], decimals: int, unit: str = "") -> str:
    """The mean alone, likewise."""
    known = [value for value in values if value is not None]
    return f"{sum(known) / len(known):.{decimals}f}{unit}{_of(values)}" if known else "–"


def _of(values: Sequence[float | None]) -> str:
    known = len(values) - values.count(None)
    return "" if known == len(values) else f" ({known} of {len(values)})"


@contextmanager
def errors_alone() -> Iterator[None]:
    """Only errors are logged: lost robots are counted, and a line for each would hide the errors."""
    log = logging.getLogger("robrain")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)


def _known_maps(shared: Path) -> tuple[dict[str, str], list[str]]:
    """Path of each map by name, empty for built-in scenarios; and the names of maps that are missing."""
    there = {name: shared / f"{name}.yaml" for name in SHARED_NAMES}
    known = {name: str(path) for name, path in there.items() if path.is_file()}
    absent = [name for name in there if name not in known]
    known |= {path.stem: str(path) for path in sorted(OWN_MAPS.glob("*.yaml"))}
    return known | {name: "" for name in sorted(builtin_names()) if name not in known}, absent


def _map_of(word: str, known: dict[str, str], absent: Sequence[str]) -> tuple[str, str]:
    if word in known:
        return word, known[word]
    if word.endswith(".yaml") and Path(word).is_file():
        return Path(word).stem, word
    reason = "it is not on this computer, see --map-folder" if word in absent else "there is no such map"
    raise UsageError(f"--maps {word}: {reason}; expected a map.yaml or one of {', '.join(known)}")


def _words(option: str, text: str) -> list[str]:
    words = list(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))
    if not words:
        raise UsageError(f"{option} {text!r}: expected names separated by commas")
    return words


def names_of(option: str, text: str, those: Collection[str] | None = None) -> list[str]:
    """The names of a text such as `exact,slipping`, each of `those` if given (UsageError for any other)."""
    words = _words(option, text)
    for word in words:
        if those is not None and word not in those:
            raise UsageError(f"{option} {word}: expected {' or '.join(those)}")
    return words


def numbers_of(option: str, text: str, least: int, most: int) -> list[int]:
    """The numbers of a text such as `1,2,4-6` (UsageError if one is not from `least` to `most`)."""
    numbers: list[int] = []
    for word in _words(option, text):
        first, _, last = word.partition("-") if not word.startswith("-") else (word, "", "")
        try:
            begin, end = int(first), int(last or first)
        except ValueError:
            raise UsageError(f"{option} {text}: expected whole numbers such as 1,2 or 1-4, got {word!r}") from None
        if not least <= begin <= end <= most:
            raise UsageError(f"{option} {text}: expected numbers from {least} to {most}, got {word!r}")
        if end - begin + len(numbers) >= NUMBERS_MAX:
            raise UsageError(f"{option} {text}: expected at most {NUMBERS_MAX} numbers")
        numbers += range(begin, end + 1)
    return list(dict.fromkeys(numbers))
