"""Fields of the mote benchmark: places by seed, the ways in which each is run, and what became of it."""

import msgspec
import numpy as np

from robrain.deploy.bench.motes.lifetime_bound import lifetime_bound_days
from robrain.deploy.errors import UsageError
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.motes.radio_graph import RadioGraph
from robrain.sim.mote_days.field_plan import FieldPlan, MoteSite, Routing
from robrain.sim.mote_days.mote_days import FieldLife, FieldRun

SIZE_M = 100.0
SINK = Point2D(0.0, 0.0)
DRAWS_MAX = 10_000
TREE, ROUTES, MULES, RELIEF, TURNS = "tree", "routes", "mules", "relief", "turns"
WAYS = {
    TREE: "a collection tree with the fewest hops, no robots",
    ROUTES: "routes in turn that spare the weak motes, no robots",
    MULES: "robots collect everything once a day",
    RELIEF: "robots collect what would wear motes down before the goal; the rest travels at once",
    TURNS: "the same, with only as many motes on duty as the coverage needs",
}


class MoteCase(msgspec.Struct, frozen=True, kw_only=True):
    """One run."""

    way: str
    seed: int
    motes: int
    tours_per_day: float
    goal_days: float

    @property
    def plan(self) -> FieldPlan:
        """How its field is run."""
        tours, goal = self.tours_per_day, self.goal_days
        return {
            TREE: FieldPlan(routing=Routing.TREE),
            ROUTES: FieldPlan(routing=Routing.LIFETIME),
            MULES: FieldPlan(routing=Routing.NONE, tours_per_day=tours),
            RELIEF: FieldPlan(routing=Routing.LIFETIME, tours_per_day=tours, goal_days=goal),
            TURNS: FieldPlan(routing=Routing.LIFETIME, tours_per_day=tours, goal_days=goal, takes_turns=True),
        }[self.way]


class MoteRun(msgspec.Struct, frozen=True, kw_only=True):
    """What became of a field."""

    case: MoteCase
    bound_days: float
    """First death at the latest, by the linear program for motes that all take readings and have no robots."""
    first_days: float
    half_days: float
    last_days: float
    delivery_ratio: float
    coverage: float
    age_h: float
    news_age_h: float
    robot_j_per_day: float
    driven_m_per_day: float


def run_case(case: MoteCase) -> MoteRun:
    """Run one field to the last mote's death."""
    site = site_of(case.seed, case.motes)
    graph = RadioGraph(site.places, site.sink, site.range_m)
    full_j = [site.energy.capacity_j] * case.motes
    run = FieldRun(site, case.plan)
    life: FieldLife = run.run()
    return MoteRun(
        case=case,
        bound_days=lifetime_bound_days(graph, full_j, site.energy, 1.0 / site.period_s),
        first_days=life.first_days,
        half_days=life.half_days,
        last_days=life.last_days,
        delivery_ratio=life.delivery_ratio,
        coverage=life.coverage,
        age_h=life.age_h,
        news_age_h=life.news_age_h,
        robot_j_per_day=life.robot_j / run.horizon_days,
        driven_m_per_day=life.driven_m / run.horizon_days,
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
