"""A mote field's life: energy and readings of all motes, from one change of routes, duties or the living to the next.

Between two changes powers and flows are constant, so that they are integrated at once: no packet is simulated. Packets
that are sent within range arrive; readings are lost in motes that die, and in full memories.
"""

import math
from enum import StrEnum
from typing import Annotated

import msgspec
from msgspec import Meta

from robrain.algorithms.motes.collect_tour import shortest_order, stops_for, tour_m
from robrain.algorithms.motes.coverage import CoverageMap, duty_set
from robrain.algorithms.motes.mote_energy import DAY_S, MoteEnergy, mica2
from robrain.algorithms.motes.routes import (
    NO_ROUTE,
    MoteRoutes,
    RadioGraph,
    lifetime_routes,
    min_hop_tree,
    routes_of,
    share_at_once,
)
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import NotNegative, Positive

HOP_S = 1.0
"""Delay of one hop: the receiver listens once in that time; chosen."""
POINTS_A_SIDE = 25
"""Sample points of the floor along each side, for the coverage."""
LEAST_GOAL_DAYS = 20.0
"""Beyond its goal the field is run as if the goal were this far away."""
MAX_S = 3650.0 * DAY_S
"""A run ends at the latest then."""
FLAT_J = 1e-6
"""A mote with no more than this remaining is dead."""


class Routing(StrEnum):
    """Routing of readings between motes."""

    TREE = "tree"
    """A collection tree with the fewest hops."""
    LIFETIME = "lifetime"
    """Alternating routes that spare the motes with little energy."""
    NONE = "none"
    """Not at all: robots collect everything."""


class MoteSite(Checked, frozen=True, kw_only=True):
    """Places and properties of motes."""

    places: tuple[Point2D, ...]
    sink: Point2D
    """Place where readings leave the field, and of the robots' charger."""
    size_m: Positive
    """The floor is a square from the origin of this width."""
    range_m: Positive = 22.0
    """Distance up to which two motes receive each other."""
    sensing_m: Positive = 15.0
    """A mote senses the floor up to this distance; chosen."""
    period_s: Positive = 60.0
    """Time between two readings of a mote."""
    energy: MoteEnergy = mica2()
    log_readings: Annotated[int, Meta(ge=1, le=1000000)] = 30_000
    """Number of readings that a mote stores; the oldest of more are lost."""


class RobotFigures(Checked, frozen=True, kw_only=True):
    """A robot that collects."""

    speed_m_s: Positive = 0.5
    idle_w: Positive = 8.0
    """All the time on a tour, for computer, sensors and radio: that of the simulated robots."""
    driving_j_per_m: Positive = 20.0
    """Additional energy for driving; about that of the simulated robots."""
    reach_m: Positive = 15.0
    """Distance up to which it collects, which leaves a margin to the radio's range."""
    readings_per_s: Positive = 25.0
    """Rate at which a mote transfers its stored readings: one every 40 ms."""


class FieldPlan(Checked, frozen=True, kw_only=True):
    """Operation of the field.

    Raises ValueError if a value makes no sense.
    """

    routing: Routing = Routing.LIFETIME
    tours_per_day: NotNegative = 0.0
    """Number of tours a day on which a robot visits all motes; 0 for none."""
    goal_days: NotNegative = 0.0
    """With tours: the lifetime that is aimed at. Readings travel over the air as far as it allows."""
    rotates_duty: bool = False
    """Whether only as many motes are on duty as the coverage needs, in turn."""
    replan_days: Positive = 10.0
    """Time after which routes and duties are made again; also after each death."""
    robot: RobotFigures = RobotFigures()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.routing is Routing.NONE and self.tours_per_day == 0:
            raise ValueError("expected tours_per_day above 0 if readings do not travel over the air")


class FieldLife(msgspec.Struct, frozen=True, kw_only=True):
    """Outcome of a simulated field."""

    deaths_days: list[float]
    """Times at which the motes died, in order."""
    collected: float
    """Readings that the motes took in the whole time."""
    delivered: float
    lost: float
    """With their motes, or in full memories."""
    stored: float
    """Still in living motes at the end."""
    due: float
    """Readings within the horizon that motes on duty took, and dead ones would have collected."""
    delivered_in_horizon: float
    coverage: float
    """Mean share of the floor within the horizon that a living mote sensed."""
    age_h: float
    """Mean age of a reading on its arrival."""
    news_age_h: float
    """Mean age, within the horizon, of the newest reading that is known of a living mote on duty."""
    spent_j: float
    """By all motes."""
    left_j: float
    """In all motes at the end."""
    robot_j: float
    """By the robots, within the horizon."""
    driven_m: float
    """By the robots, within the horizon."""

    @property
    def first_days(self) -> float:
        """Time at which the first mote died."""
        return self.deaths_days[0] if self.deaths_days else math.inf

    @property
    def half_days(self) -> float:
        """Time at which half of the motes were dead."""
        return self.deaths_days[(len(self.deaths_days) - 1) // 2] if self.deaths_days else math.inf

    @property
    def last_days(self) -> float:
        """Time at which the last mote died."""
        return self.deaths_days[-1] if self.deaths_days else math.inf

    @property
    def delivery_ratio(self) -> float:
        """Share of the readings due within the horizon that arrived."""
        return self.delivered_in_horizon / self.due if self.due else 0.0


HORIZON_DAYS = 365.0
"""Time over which delivery, coverage and the robots' work are counted."""
HORIZON_S = HORIZON_DAYS * DAY_S


def field_life(site: MoteSite, plan: FieldPlan) -> FieldLife:
    """The life of a field.

    Args:
        site: places and properties of the motes.
        plan: how the field is run.

    """
    return _FieldRun(site, plan).run()


class _FieldRun:
    """State of a field; arguments are those of `field_life`."""

    def __init__(self, site: MoteSite, plan: FieldPlan) -> None:
        self.site, self.plan = site, plan
        self.graph = RadioGraph(site.places, site.sink, site.range_m)
        count = len(site.places)
        step_m = site.size_m / POINTS_A_SIDE
        sides_m = [(index + 0.5) * step_m for index in range(POINTS_A_SIDE)]
        points = [Point2D(x_m, y_m) for x_m in sides_m for y_m in sides_m]
        self._cover = CoverageMap(site.places, points, site.sensing_m)
        self.left_j = [site.energy.capacity_j] * count
        self.stored = [0.0] * count
        self.alive = set(range(count))
        self._on_duty = set(self.alive)
        self._routes: MoteRoutes | None = None
        self._share = 1.0
        self._has_route = [False] * count
        self._tours_m: dict[tuple[int, ...], float] = {}
        self.now_s = 0.0
        self._next_plan_s = 0.0
        self._known_s = [0.0] * count
        """Time of the newest known reading of each mote."""
        self._next_tour_s = DAY_S / plan.tours_per_day if plan.tours_per_day else math.inf
        self._deaths_s: list[float] = []
        self._collected = self._delivered = self._lost = self._early = 0.0
        self._age_sum_s = self._news_sum_s = self._watched_s = self._due = 0.0
        self._covered_s = self._spent_j = self._robot_j = self._driven_m = 0.0

    def run(self) -> FieldLife:
        """Live until all motes are dead, or the time is over."""
        while self.alive and self.now_s < MAX_S:
            if self.now_s >= self._next_plan_s:
                self._make_plan()
            powers_w = {mote: self._power_w(mote) for mote in sorted(self.alive)}
            dies_s = min(self.left_j[mote] / power_w for mote, power_w in powers_w.items())
            ends_s = [self._next_plan_s, self._next_tour_s, MAX_S]
            ends_s += [HORIZON_S] if self.now_s < HORIZON_S else []
            self._pass(max(0.0, min(dies_s, min(ends_s) - self.now_s)), powers_w)
            if self.now_s >= self._next_tour_s:
                self._tour()
            self._bury()
        return self._life()

    def _make_plan(self) -> None:
        site, plan = self.site, self.plan
        self._next_plan_s = self.now_s + plan.replan_days * DAY_S
        living = sorted(self.alive)
        self._on_duty = set(self.alive)
        if plan.rotates_duty:
            left = {mote: max(self.left_j[mote] / site.energy.capacity_j, FLAT_J) for mote in living}
            self._on_duty = set(duty_set(self._cover, left))
        awake = sorted(self._on_duty)
        rate_hz = 1.0 / site.period_s
        if plan.routing is Routing.NONE:
            self._routes = routes_of(self.graph, [[NO_ROUTE] * self.graph.sink], ())
        elif plan.routing is Routing.TREE:
            self._routes = routes_of(self.graph, [min_hop_tree(self.graph, awake)], awake)
        else:
            self._routes = lifetime_routes(self.graph, self.left_j, awake, site.energy, rate_hz)
        self._has_route = [hops > 0 for hops in self._routes.hops]
        self._share = self._share_at_once(self._routes, rate_hz) if plan.tours_per_day else 1.0
        self._spend_on_beacons(len(self._routes.trees) if plan.routing is not Routing.NONE else 0, awake)

    def _share_at_once(self, routes: MoteRoutes, rate_hz: float) -> float:
        """Share of the readings that travel over the air so that no mote dies before the goal."""
        energy, awake = self.site.energy, self._on_duty
        goal_s = max(LEAST_GOAL_DAYS * DAY_S, self.plan.goal_days * DAY_S - self.now_s)
        budgets_w = [
            left_j / goal_s - energy.awake_w - rate_hz * energy.reading_j if mote in awake else 0.0
            for mote, left_j in enumerate(self.left_j)
        ]
        return share_at_once(routes, awake, budgets_w, energy, rate_hz)

    def _spend_on_beacons(self, trees: int, awake: list[int]) -> None:
        """Each tree is made from one beacon of every mote on duty, which its neighbours receive."""
        energy = self.site.energy
        for mote in awake:
            neighbours = sum(other in self._on_duty for other in self.graph.neighbours[mote])
            spent_j = trees * (energy.beacon_send_j + neighbours * energy.beacon_receive_j)
            spent_j = min(spent_j, self.left_j[mote])
            self.left_j[mote] -= spent_j
            self._spent_j += spent_j

    def _power_w(self, mote: int) -> float:
        energy, routes = self.site.energy, self._routes
        assert routes is not None
        if mote not in self._on_duty:
            return energy.asleep_w
        rate_hz = 1.0 / self.site.period_s
        on_air_w = (
            self._share * rate_hz * (routes.sent[mote] * energy.send_j + routes.received[mote] * energy.receive_j)
        )
        return energy.awake_w + rate_hz * energy.reading_j + on_air_w

    def _pass(self, step_s: float, powers_w: dict[int, float]) -> None:
        """Let time pass with constant powers and flows."""
        routes = self._routes
        assert routes is not None
        reported = set()
        for mote, power_w in powers_w.items():
            spent_j = power_w * step_s
            self.left_j[mote] -= spent_j
            self._spent_j += spent_j
            if mote not in self._on_duty:
                continue
            collected = step_s / self.site.period_s
            at_once = collected * self._share if self._has_route[mote] else 0.0
            self._collected += collected
            self._deliver(at_once, routes.hops[mote] * HOP_S)
            self.stored[mote] += collected - at_once
            over = max(0.0, self.stored[mote] - self.site.log_readings)
            self.stored[mote] -= over
            self._lost += over
            if self._has_route[mote] or self.plan.tours_per_day:
                reported.add(mote)
            self._record_ages(mote, step_s, routes.hops[mote])
        if self.now_s < HORIZON_S:
            self._covered_s += step_s * self._cover.share(reported)
            dead = len(self.site.places) - len(self.alive)
            self._due += (len(self._on_duty) + dead) * step_s / self.site.period_s
        self.now_s += step_s

    def _record_ages(self, mote: int, step_s: float, hops: float) -> None:
        """Count the age of the newest reading that is known of a mote, over a step."""
        if self.now_s >= HORIZON_S:
            return
        tour_s = DAY_S / self.plan.tours_per_day if self.plan.tours_per_day else math.inf
        by_air_s = self.site.period_s / self._share if self._has_route[mote] and self._share > 0 else math.inf
        between_s = min(tour_s, by_air_s)
        if math.isfinite(between_s):
            mean_s = hops * HOP_S + 0.5 * between_s
            self._known_s[mote] = self.now_s + step_s
        else:
            mean_s = self.now_s + 0.5 * step_s - self._known_s[mote]
        self._news_sum_s += step_s * mean_s
        self._watched_s += step_s

    def _deliver(self, readings: float, age_s: float) -> None:
        self._delivered += readings
        self._age_sum_s += readings * age_s
        if self.now_s < HORIZON_S:
            self._early += readings

    def _tour(self) -> None:
        """A robot visits the living motes that have stored something, and takes it."""
        tour_s, robot = DAY_S / self.plan.tours_per_day, self.plan.robot
        readings = 0.0
        motes = tuple(mote for mote in sorted(self.alive) if self.stored[mote] > 0)
        path_m = self._path_m(motes)
        for mote in motes:
            handed = min(self.stored[mote], max(0.0, self.left_j[mote]) / self.site.energy.hand_over_j)
            spent_j = handed * self.site.energy.hand_over_j
            self.left_j[mote] -= spent_j
            self._spent_j += spent_j
            self.stored[mote] -= handed
            self._deliver(handed, 0.5 * tour_s + 0.5 * path_m / robot.speed_m_s)
            readings += handed
        if self.now_s <= HORIZON_S:
            duration_s = path_m / robot.speed_m_s + readings / robot.readings_per_s
            self._robot_j += robot.idle_w * duration_s + robot.driving_j_per_m * path_m
            self._driven_m += path_m
        self._next_tour_s += tour_s

    def _path_m(self, motes: tuple[int, ...]) -> float:
        """Length of the tour that serves these motes."""
        if motes not in self._tours_m:
            stops = stops_for(self.site.places, motes, self.plan.robot.reach_m)
            places = [stop.place for stop in stops]
            order = shortest_order(self.site.sink, places)
            self._tours_m[motes] = tour_m(self.site.sink, [places[index] for index in order])
        return self._tours_m[motes]

    def _bury(self) -> None:
        for mote in sorted(self.alive):
            if self.left_j[mote] <= FLAT_J:
                self.alive.remove(mote)
                self._deaths_s.append(self.now_s)
                self._lost += self.stored[mote]
                self.stored[mote] = 0.0
                self._next_plan_s = self.now_s

    def _life(self) -> FieldLife:
        return FieldLife(
            deaths_days=[death_s / DAY_S for death_s in self._deaths_s],
            collected=self._collected,
            delivered=self._delivered,
            lost=self._lost,
            stored=sum(self.stored),
            due=self._due,
            delivered_in_horizon=self._early,
            coverage=self._covered_s / HORIZON_S,
            age_h=self._age_sum_s / max(self._delivered, 1e-9) / 3600.0,
            news_age_h=self._news_sum_s / max(self._watched_s, 1e-9) / 3600.0,
            spent_j=self._spent_j,
            left_j=sum(max(0.0, joules) for joules in self.left_j),
            robot_j=self._robot_j,
            driven_m=self._driven_m,
        )
