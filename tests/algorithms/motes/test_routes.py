"""Routes of a mote field: every reading is accounted for, and no routes outlive the linear-programming bound."""

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.motes.collect_tour import shortest_order, stops_for, tour_m
from robrain.algorithms.motes.coverage import CoverageMap, duty_set
from robrain.algorithms.motes.mote_energy import DAY_S, mica2
from robrain.algorithms.motes.routes import (
    NO_ROUTE,
    MoteRoutes,
    RadioGraph,
    lifetime_routes,
    min_hop_tree,
    routes_of,
    share_at_once,
)
from robrain.lab.bench.motes import lifetime_bound_days
from robrain.protocol.model.geometry import Point2D
from tests.algorithms.motes.fields import ORIGIN, line, scattered

ENERGY = mica2()
RATE_HZ = 1.0 / 60.0
SEEDS = st.integers(0, 10_000)


def first_death_days(graph: RadioGraph, routes: MoteRoutes) -> float:
    powers_w = [
        ENERGY.awake_w
        + RATE_HZ * (ENERGY.reading_j + routes.sent[mote] * ENERGY.send_j + routes.received[mote] * ENERGY.receive_j)
        for mote in range(graph.sink)
    ]
    return ENERGY.capacity_j / max(powers_w) / DAY_S


def best_routes(graph: RadioGraph, left_j: list[float] | None = None) -> MoteRoutes:
    return lifetime_routes(graph, left_j or [ENERGY.capacity_j] * graph.sink, range(graph.sink), ENERGY, RATE_HZ)


@given(seed=SEEDS)
@settings(max_examples=25, deadline=None)
def test_every_reading_is_sent_on_until_it_is_at_the_sink(seed: int) -> None:
    graph = scattered(seed)
    for routes in (best_routes(graph), routes_of(graph, [min_hop_tree(graph, range(40))], range(40))):
        for mote in range(graph.sink):
            assert routes.sent[mote] == pytest.approx(routes.received[mote] + 1.0)
        assert sum(routes.sent) == pytest.approx(sum(routes.hops))


@pytest.mark.slow
@given(seed=SEEDS)
@settings(max_examples=25, deadline=None)
def test_no_routes_outlive_the_bound_and_those_in_turn_come_near_it(seed: int) -> None:
    graph = scattered(seed)
    bound_days = lifetime_bound_days(graph, [ENERGY.capacity_j] * graph.sink, ENERGY, RATE_HZ)
    tree = routes_of(graph, [min_hop_tree(graph, range(40))], range(40))
    assert first_death_days(graph, tree) <= bound_days * (1 + 1e-6)
    assert 0.9 * bound_days <= first_death_days(graph, best_routes(graph)) <= bound_days * (1 + 1e-6)


def test_bound_of_a_chain_is_the_life_of_the_mote_at_the_sink() -> None:
    graph = line(9.0, 18.0, 27.0)
    power_w = ENERGY.awake_w + RATE_HZ * (ENERGY.reading_j + 3 * ENERGY.send_j + 2 * ENERGY.receive_j)
    expected_days = ENERGY.capacity_j / power_w / DAY_S
    assert lifetime_bound_days(graph, [ENERGY.capacity_j] * 3, ENERGY, RATE_HZ) == pytest.approx(expected_days)


def test_nearly_empty_mote_is_spared() -> None:
    # Mote 2 reaches the sink by mote 0 or by mote 1, which are alike but for what they have left.
    graph = line(5.0, 5.0, 14.0)
    routes = best_routes(graph, [ENERGY.capacity_j, 0.1 * ENERGY.capacity_j, ENERGY.capacity_j])
    assert routes.received[1] < 0.1 < 0.9 < routes.received[0]


def test_dead_motes_forward_nothing_and_cut_off_motes_have_no_route() -> None:
    graph = line(9.0, 18.0, 27.0)
    tree = min_hop_tree(graph, [0, 2])
    assert tree == [graph.sink, NO_ROUTE, NO_ROUTE]
    routes = routes_of(graph, [tree], [0, 2])
    assert (routes.sent, routes.received, routes.hops) == ([1.0, 0.0, 0.0], [0.0] * 3, [1.0, 0.0, 0.0])


def test_as_much_travels_at_once_as_the_weakest_mote_can_carry() -> None:
    graph = line(9.0, 18.0)
    routes = routes_of(graph, [min_hop_tree(graph, range(2))], range(2))
    all_w = RATE_HZ * (2 * ENERGY.send_j + ENERGY.receive_j)
    handed_w = RATE_HZ * ENERGY.hand_over_j
    assert share_at_once(routes, range(2), [1.0, 1.0], ENERGY, RATE_HZ) == 1.0
    assert share_at_once(routes, range(2), [0.5 * (all_w + handed_w), 1.0], ENERGY, RATE_HZ) == pytest.approx(0.5)
    assert share_at_once(routes, range(2), [0.0, 1.0], ENERGY, RATE_HZ) == 0.0


COORDINATES = st.floats(0.0, 100.0, allow_nan=False)
PLACES = st.lists(st.builds(Point2D, COORDINATES, COORDINATES), min_size=1, max_size=25)
GRID = [Point2D(5.0 * column, 5.0 * row) for column in range(21) for row in range(21)]


@given(places=PLACES, shares=st.lists(st.floats(0.01, 1.0), min_size=25, max_size=25))
@settings(max_examples=50, deadline=None)
def test_motes_on_duty_cover_what_all_cover_and_each_is_needed(places: list[Point2D], shares: list[float]) -> None:
    cover = CoverageMap(places, GRID, 15.0)
    left = dict(enumerate(shares[: len(places)]))
    chosen = duty_set(cover, left)
    assert cover.spots(chosen) == cover.spots(left)
    for mote in chosen:
        assert cover.spots([other for other in chosen if other != mote]) != cover.spots(left)


@given(places=PLACES)
@settings(max_examples=50, deadline=None)
def test_stops_serve_each_mote_once_and_within_reach(places: list[Point2D]) -> None:
    stops = stops_for(places, range(len(places)), 15.0)
    assert sorted(mote for stop in stops for mote in stop.motes) == list(range(len(places)))
    for stop in stops:
        assert all(
            math.hypot(places[mote].x_m - stop.place.x_m, places[mote].y_m - stop.place.y_m) <= 15.0
            for mote in stop.motes
        )


@given(places=st.lists(st.builds(Point2D, COORDINATES, COORDINATES), min_size=1, max_size=6))
@settings(max_examples=30, deadline=None)
def test_tour_is_near_the_shortest_of_all_orders(places: list[Point2D]) -> None:
    order = shortest_order(ORIGIN, places)
    assert sorted(order) == list(range(len(places)))
    best_m = min(tour_m(ORIGIN, list(each)) for each in itertools.permutations(places))
    assert tour_m(ORIGIN, [places[index] for index in order]) <= 1.25 * best_m + 1e-6
