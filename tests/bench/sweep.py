"""What a second process brings to a sweep."""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from robrain import Scenario
from robrain.deploy.processes.kernels import prepare_kernels
from robrain.lab.bench.figure import Figure, at_least, at_most, deterministic, timing
from robrain.lab.sweep.plan import make_plan
from robrain.lab.sweep.sweep import TABLE, SweepOptions, run_sweep

RUNS = 30
SIMULATED_S = 60.0


def measure() -> Iterator[Figure]:
    """The speed-up of two processes over one, start of the processes included, and whether the tables agree."""
    prepare_kernels(quiet=True)
    with tempfile.TemporaryDirectory() as folder:
        one_s, one = _sweep(Path(folder) / "one", 1)
        two_s, two = _sweep(Path(folder) / "two", 2)
    beside = f"{RUNS} runs in {one_s:.1f} s by one process, {two_s:.1f} s by two"
    yield timing("30 runs: two processes over one", one_s / two_s, "×", at_least(1.85), beside)
    yield deterministic("tables of one and of two processes that differ", float(one != two), "", at_most(0))


def _sweep(folder: Path, workers: int) -> tuple[float, bytes]:
    scenario = Scenario.builtin("depot").replace(time_limit_s=SIMULATED_S, until_explored=1.0)
    plan = make_plan(scenario, range(1, RUNS + 1), {})
    started_s = time.perf_counter()
    run_sweep(plan, SweepOptions(output=folder, workers=workers))
    return time.perf_counter() - started_s, (folder / TABLE).read_bytes()
