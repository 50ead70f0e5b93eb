"""Life of a mote field: a plain collection tree, energy-aware routes, and robots as mules, beside the bound."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np
from rich.table import Table
from scipy.optimize import linprog
from scipy.sparse import coo_array

from robrain.algorithms.motes.field_life import HORIZON_DAYS, FieldPlan, MoteSite, Routing, field_life
from robrain.algorithms.motes.mote_energy import DAY_S, MoteEnergy
from robrain.algorithms.motes.routes import RadioGraph
from robrain.deploy.command_line.terminal import print_line
from robrain.deploy.errors import UsageError
from robrain.lab.bench.figure import Figure, at_least, deterministic
from robrain.lab.bench.mapping_plan import BenchPlan, interval_words, mean_words, names_of, numbers_of, run_all
from robrain.protocol.model.geometry import Point2D
from robrain.sim.scenarios.scenario_file import MAX_SEED

SIZE_M = 100.0
SINK = Point2D(0.0, 0.0)
DRAWS_MAX = 10_000
TREE, ROUTES, MULES, RELIEF, TURNS = "tree", "routes", "mules", "relief", "turns"
METHODS = {
    TREE: "a collection tree with the fewest hops, no robots",
    ROUTES: "routes in turn that spare the weak motes, no robots",
    MULES: "robots collect everything once a day",
    RELIEF: "robots collect what would wear motes down before the goal; the rest travels at once",
    TURNS: "the same, with only as many motes on duty as the coverage needs",
}
OF_BOUND = 0.9
"""Least lifetime over the linear program's, on every field."""
OVER_TREE = 3.5
"""Least mean lifetime with robots over that of the plain tree."""
MOTES_MAX = 1000
WIDTH = 132


def lifetime_bound_days(graph: RadioGraph, left_j: list[float], energy: MoteEnergy, rate_hz: float) -> float:
    """No routes let all motes live longer than this, if each sends `rate_hz` readings a second to the sink.

    Maximum lifetime routing (Chang and Tassiulas, IEEE/ACM Transactions on Networking 12(4), 2004): maximise T. Each
    mote forwards everything that it senses and receives in T, and has the energy for it. The unknowns are the packets
    of each link in T, in thousands, and T in days.

    Raises:
        ValueError: a mote does not reach the sink.

    """
    if len(graph.reachable()) < graph.sink:
        raise ValueError("expected motes that all reach the sink")
    links = [(mote, other) for mote in range(graph.sink) for other in graph.neighbours[mote]]
    last = len(links)
    packets = 1000.0
    flow: list[tuple[int, int, float]] = [(mote, last, -rate_hz * DAY_S / packets) for mote in range(graph.sink)]
    spent: list[tuple[int, int, float]] = [
        (mote, last, DAY_S * (energy.awake_w + rate_hz * energy.reading_j)) for mote in range(graph.sink)
    ]
    for column, (mote, other) in enumerate(links):
        flow.append((mote, column, 1.0))
        spent.append((mote, column, packets * energy.send_j))
        if other != graph.sink:
            flow.append((other, column, -1.0))
            spent.append((other, column, packets * energy.receive_j))
    size = (graph.sink, last + 1)
    gain = np.zeros(last + 1)
    gain[last] = -1.0
    zeros = np.zeros(graph.sink)
    limits, balances = _matrix(spent, size), _matrix(flow, size)
    solved = linprog(gain, limits, left_j, balances, zeros, method="highs")  # type: ignore[call-overload]
    if solved.x is None:
        raise ValueError(f"the linear program has no solution: {solved.message}")
    return float(solved.x[last])


def _matrix(entries: list[tuple[int, int, float]], size: tuple[int, int]) -> coo_array:
    rows, columns, values = zip(*entries, strict=True)
    return coo_array((np.array(values), (np.array(rows), np.array(columns))), shape=size)


class MoteCase(msgspec.Struct, frozen=True, kw_only=True):
    """One run."""

    method: str
    seed: int
    motes: int
    tours_per_day: float
    goal_days: float

    @property
    def plan(self) -> FieldPlan:
        """Method of running its field."""
        tours, goal = self.tours_per_day, self.goal_days
        return {
            TREE: FieldPlan(routing=Routing.TREE),
            ROUTES: FieldPlan(routing=Routing.LIFETIME),
            MULES: FieldPlan(routing=Routing.NONE, tours_per_day=tours),
            RELIEF: FieldPlan(routing=Routing.LIFETIME, tours_per_day=tours, goal_days=goal),
            TURNS: FieldPlan(routing=Routing.LIFETIME, tours_per_day=tours, goal_days=goal, rotates_duty=True),
        }[self.method]


class MoteFieldRun(msgspec.Struct, frozen=True, kw_only=True):
    """Outcome of a field."""

    case: MoteCase
    bound_days: float
    """First death at the latest, by the linear program for motes that all send readings and have no robots."""
    first_days: float
    half_days: float
    last_days: float
    delivery_ratio: float
    coverage: float
    age_h: float
    news_age_h: float
    robot_j_per_day: float
    driven_m_per_day: float


def run_case(case: MoteCase) -> MoteFieldRun:
    """Run one field to the last mote's death."""
    site = site_of(case.seed, case.motes)
    graph = RadioGraph(site.places, site.sink, site.range_m)
    full_j = [site.energy.capacity_j] * case.motes
    life = field_life(site, case.plan)
    return MoteFieldRun(
        case=case,
        bound_days=lifetime_bound_days(graph, full_j, site.energy, 1.0 / site.period_s),
        first_days=life.first_days,
        half_days=life.half_days,
        last_days=life.last_days,
        delivery_ratio=life.delivery_ratio,
        coverage=life.coverage,
        age_h=life.age_h,
        news_age_h=life.news_age_h,
        robot_j_per_day=life.robot_j / HORIZON_DAYS,
        driven_m_per_day=life.driven_m / HORIZON_DAYS,
    )


def site_of(seed: int, motes: int) -> MoteSite:
    """Motes at random places of a square of 100 m, the sink in a corner; drawn again until all reach the sink.

    Raises:
        UsageError: so few motes do not connect.

    """
    rng = np.random.default_rng(seed)
    for _ in range(DRAWS_MAX):
        drawn = rng.uniform(0.0, SIZE_M, (motes, 2)).tolist()
        site = MoteSite(places=tuple(Point2D(x_m, y_m) for x_m, y_m in drawn), sink=SINK, size_m=SIZE_M)
        if len(RadioGraph(site.places, site.sink, site.range_m).reachable()) == motes:
            return site
    raise UsageError(f"--motes {motes}: {DRAWS_MAX} draws had no field in which all motes reach the sink; take more")


def choose(
    methods: str | None, seeds: str, motes: int, tours_per_day: float, goal_days: float, jobs: int
) -> BenchPlan[MoteCase]:
    """Make a plan from the options.

    Raises:
        UsageError: an option is wrong; the text names it and the expected value.

    """
    names = list(METHODS) if methods is None else names_of("--methods", methods, METHODS)
    drawn = numbers_of("--seeds", seeds, 0, MAX_SEED)
    if not 1 <= motes <= MOTES_MAX:
        raise UsageError(f"--motes {motes}: expected 1 to {MOTES_MAX}")
    if jobs < 1:
        raise UsageError(f"--jobs {jobs}: expected at least 1")
    for option, value in (("--tours-per-day", tours_per_day), ("--goal-days", goal_days)):
        if not 0 < value <= 1e4:
            raise UsageError(f"{option} {value:g}: expected a number above 0 and at most 10000")
    cases = [
        MoteCase(method=method, seed=seed, motes=motes, tours_per_day=tours_per_day, goal_days=goal_days)
        for method in names
        for seed in drawn
    ]
    return BenchPlan(cases=cases, jobs=jobs)


def run_bench(plan: BenchPlan[MoteCase], json_file: Path | None = None) -> None:
    """Execute all runs; print a line for each way to run the field, and the table and figures at the end."""

    def report(runs: list[MoteFieldRun]) -> None:
        method = runs[-1].case.method
        if len(runs) == len(plan.cases) or plan.cases[len(runs)].method != method:
            first_days = [one.first_days for one in runs if one.case.method == method]
            print_line(f"{method}: first dead mote after {interval_words(first_days, 0)} days")

    run_all("motes", plan, run_case, report, figures, json_file, table=table, width=WIDTH)


def table(runs: Sequence[MoteFieldRun]) -> Table:
    """Means over the seeds; a row for each method of running the field."""
    count = runs[0].case.motes
    title = (
        f"{count} motes on 100 × 100 m: means over the seeds (± 95 % interval); from arrived to m/d in the first year"
    )
    shown = Table(title=title, title_justify="left")
    shown.add_column("method", no_wrap=True)
    headings = ("runs", "first dead d", "half d", "last d", "of bound", "× tree", "arrived", "covered", "age h")
    for heading in (*headings, "newest h", "robot kJ/d", "m/d"):
        shown.add_column(heading, justify="right", no_wrap=True)
    tree_days = _mean([run.first_days for run in runs if run.case.method == TREE])
    for method, made in _by_method(runs).items():
        first_days = [run.first_days for run in made]
        shown.add_row(
            method,
            str(len(made)),
            interval_words(first_days, 0),
            mean_words([run.half_days for run in made], 0),
            mean_words([run.last_days for run in made], 0),
            mean_words([run.first_days / run.bound_days for run in made], 2),
            mean_words([days / tree_days for days in first_days if tree_days is not None], 2),
            mean_words([100 * run.delivery_ratio for run in made], 1, " %"),
            mean_words([100 * run.coverage for run in made], 1, " %"),
            mean_words([run.age_h for run in made], 1),
            mean_words([run.news_age_h for run in made], 1),
            mean_words([run.robot_j_per_day / 1000.0 for run in made], 1),
            mean_words([run.driven_m_per_day for run in made], 0),
        )
    return shown


def figures(runs: Sequence[MoteFieldRun]) -> Iterator[Figure]:
    """Figures of the comparison: routes against the bound, and robots against the tree."""
    methods = _by_method(runs)
    routes = methods.get(ROUTES, [])
    if routes:
        shares = [run.first_days / run.bound_days for run in routes]
        yield deterministic(
            "lifetime with routes in turn over the linear-programming bound, least",
            min(shares),
            bound=at_least(OF_BOUND),
            beside=f"mean {sum(shares) / len(shares):.3f} of {len(shares)} fields",
        )
    tree_days = _mean([run.first_days for run in methods.get(TREE, [])])
    for method in (MULES, RELIEF):
        made = methods.get(method, [])
        first_days = _mean([run.first_days for run in made])
        if first_days is not None and tree_days is not None:
            age_h, news_h = (mean_words([getattr(run, name) for run in made], 1) for name in ("age_h", "news_age_h"))
            energy_kj = mean_words([run.robot_j_per_day / 1000.0 for run in made], 1)
            yield deterministic(
                f"lifetime with {method} over that of the collection tree",
                first_days / tree_days,
                bound=at_least(OVER_TREE),
                beside=f"data {age_h} h old, newest {news_h} h; {energy_kj} kJ a day",
            )


def _by_method(runs: Sequence[MoteFieldRun]) -> dict[str, list[MoteFieldRun]]:
    return {method: made for method in METHODS if (made := [run for run in runs if run.case.method == method])}


def _mean(values: Iterable[float]) -> float | None:
    known = list(values)
    return sum(known) / len(known) if known else None
