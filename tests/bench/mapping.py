"""Accuracy of maps and positions, some runs of `robrain bench mapping`; and robots with unknown starts."""

from collections.abc import Iterator

from robrain.lab.bench import mapping as bench_mapping
from robrain.lab.bench.figure import Figure
from robrain.lab.bench.mapping_plan import choose
from tests.bench import joining as bench_joining

FLOORS = "clinic,warehouse"
ROBOTS, SEEDS = "4", "1-2"
JOINED_ROBOTS, JOINED_SEEDS = "3", "1-2"
LIMIT_S = 150.0


def measure() -> Iterator[Figure]:
    """Teams with wheels that slip on two floors of the project, in time and late; then robots with unknown starts."""
    plan = choose(FLOORS, ROBOTS, SEEDS, "slipping", 1, LIMIT_S, conditions="usual,late")
    yield from bench_mapping.figures(map(bench_mapping.run_case, plan.cases))
    joining = choose("clinic", JOINED_ROBOTS, JOINED_SEEDS, "slipping", 1, LIMIT_S)
    runs = [bench_joining.run_case((case, kind)) for kind in bench_joining.KINDS for case in joining.cases]
    yield from bench_joining.figures(each for run in runs for each in run)
