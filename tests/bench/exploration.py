"""Exploration of map files: simulated time, collisions and real-time factor.

Each run is one of `RUNS`, in lockstep. Time, explored share, distance and collisions depend on the seed alone;
`tests/sim` compares them with their bounds and with the printed tables. Cost is timed, and counted in Python function
calls, which `tests/ceilings.py` compares with their ceilings.
"""

from collections.abc import Iterator
from pathlib import Path

import msgspec

from robrain import RunResult, Scenario
from robrain.algorithms.warm_up import warm_up
from robrain.lab.bench.figure import Figure, at_least, at_most, deterministic, timing
from tests.bench.call_count import calls_per_robot_second
from tests.real_maps import REAL_MAPS, require_real_maps

OWN_MAPS = Path(__file__).parents[2] / "examples" / "maps"
SEED = 7
SEEDS = range(1, 9)
REAL_TIME_FACTOR = 20.0
DEEPEST_M = 0.01
SETTLE_S, WINDOW_S = 3.0, 8.0
CROWD, CROWD_WINDOW_S = 64, 1.0


class Exploration(msgspec.Struct, frozen=True, kw_only=True):
    """One run and its bounds."""

    map_path: Path
    robots: int = 4
    until: float
    """The run ends when this share of the floor is known."""
    longest_s: float
    """The measured value plus a tenth for different routes."""
    mean_s: float | None = None
    """The same for the mean of `SEEDS`, as one seed's run may take a fifth longer after any change."""
    least_factor: float | None = None
    """Of real time."""

    @property
    def name(self) -> str:
        """Prefix of the names of its figures."""
        return f"{self.map_path.stem}, {self.robots} robots, seed {SEED}"

    def run(self, seed: int = SEED) -> RunResult:
        """Explore the map."""
        return Scenario.from_map(self.map_path, robots=self.robots).replace(seed=seed).run(until_explored=self.until)


OWN = Exploration(map_path=OWN_MAPS / "clinic.yaml", robots=3, until=0.97, longest_s=57.0)
DEPOT = Exploration(
    map_path=REAL_MAPS / "nav2_depot.yaml", until=0.95, longest_s=51.0, mean_s=42.0, least_factor=REAL_TIME_FACTOR
)
RUNS = (
    OWN,
    DEPOT,
    Exploration(map_path=REAL_MAPS / "stage_hospital_section.yaml", until=0.9, longest_s=100.0, mean_s=98.0),
    Exploration(map_path=REAL_MAPS / "stage_cave.yaml", until=0.9, longest_s=34.0),
)


def measure() -> Iterator[Figure]:
    """Runs on the project's own map."""
    warm_up()
    yield from run_figures(OWN, OWN.run())


def measure_real_maps() -> Iterator[Figure]:
    """Runs on the real maps (FileNotFoundError without them)."""
    require_real_maps()
    warm_up()
    for exploration in RUNS[1:]:
        yield from run_figures(exploration, exploration.run())
    for exploration in RUNS:
        if exploration.mean_s is not None:
            yield from mean_figures(exploration, exploration.mean_s)


def mean_figures(exploration: Exploration, mean_bound_s: float) -> Iterator[Figure]:
    """Figures over several seeds, as a single one says little about a change."""
    results = [exploration.run(seed) for seed in SEEDS]
    mean_s = sum(result.sim_time_s for result in results) / len(results)
    what = f"{exploration.map_path.stem}, {exploration.robots} robots, seeds {SEEDS.start} to {SEEDS.stop - 1}"
    longest_s = max(result.sim_time_s for result in results)
    yield deterministic(
        f"{what}: simulated time, mean", mean_s, "s", at_most(mean_bound_s), f"longest {longest_s:.1f} s"
    )
    yield deterministic(f"{what}: collisions", sum(result.collisions for result in results), "", at_most(0))


def run_figures(exploration: Exploration, result: RunResult) -> list[Figure]:
    """The figures of one run."""
    name = exploration.name
    is_there = at_least(100 * exploration.until)
    factor_bound = at_least(exploration.least_factor) if exploration.least_factor is not None else None
    return [
        deterministic(f"{name}: explored", 100 * result.explored_fraction, "%", is_there, f"ended: {result.ended}"),
        deterministic(f"{name}: simulated time", result.sim_time_s, "s", at_most(exploration.longest_s)),
        deterministic(f"{name}: collisions", result.collisions, "", at_most(0)),
        deterministic(f"{name}: deepest in a wall", 1000 * result.wall_overlap_m, "mm", at_most(1000 * DEEPEST_M)),
        deterministic(f"{name}: way driven", result.distance_m, "m"),
        timing(f"{name}: real-time factor", result.real_time_factor, "×", factor_bound),
    ]


def calls() -> tuple[int, int, int]:
    """Python function calls per robot and simulated second: 4 robots exploring, 64, and with nothing left to do."""
    depot, small = Scenario.builtin("depot"), Scenario.builtin("arena_small")
    exploring = calls_per_robot_second(depot, settle_s=SETTLE_S, window_s=WINDOW_S)
    crowded = calls_per_robot_second(depot.replace(robots=CROWD), settle_s=SETTLE_S, window_s=CROWD_WINDOW_S)
    waiting = calls_per_robot_second(small, until=lambda run: run.nothing_left, window_s=WINDOW_S)
    return round(exploring), round(crowded), round(waiting)
