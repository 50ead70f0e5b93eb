"""Routes of a mote field: every reading is accounted for, and no routes outlive the linear-programming bound."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.motes.mote_energy import DAY_S, mica2
from robrain.algorithms.motes.routes import (
    NO_ROUTE,
    MoteRoutes,
    RadioGraph,
    cheapest_tree,
    lifetime_routes,
    min_hop_tree,
    routes_of,
    share_at_once,
)
from robrain.lab.bench.motes import lifetime_bound_days
from tests.algorithms.motes.fields import line, scattered

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


def test_cheapest_tree_takes_a_way_around_a_dear_mote() -> None:
    graph = line(5.0, 6.0, 14.0)
    assert cheapest_tree(graph, [1.0, 5.0, 1.0], range(3), ENERGY)[2] == 0
    assert cheapest_tree(graph, [5.0, 1.0, 1.0], range(3), ENERGY)[2] == 1


def test_dead_motes_forward_nothing_and_cut_off_motes_have_no_route() -> None:
    graph = line(9.0, 18.0, 27.0)
    tree = min_hop_tree(graph, [0, 2])
    assert tree == [graph.sink, NO_ROUTE, NO_ROUTE]
    routes = routes_of(graph, [tree], [0, 2])
    assert (routes.sent, routes.received, routes.hops) == ([1.0, 0.0, 0.0], [0.0] * 3, [1.0, 0.0, 0.0])


def test_min_hop_tree_takes_the_nearest_of_parents_with_as_few_hops() -> None:
    assert min_hop_tree(line(5.0, 9.0, 14.0), range(3))[2] == 1
    assert min_hop_tree(line(9.0, 5.0, 14.0), range(3))[2] == 0


def test_as_much_travels_at_once_as_the_weakest_mote_can_carry() -> None:
    graph = line(9.0, 18.0)
    routes = routes_of(graph, [min_hop_tree(graph, range(2))], range(2))
    all_w = RATE_HZ * (2 * ENERGY.send_j + ENERGY.receive_j)
    handed_w = RATE_HZ * ENERGY.hand_over_j
    assert share_at_once(routes, range(2), [1.0, 1.0], ENERGY, RATE_HZ) == 1.0
    assert share_at_once(routes, range(2), [0.5 * (all_w + handed_w), 1.0], ENERGY, RATE_HZ) == pytest.approx(0.5)
    assert share_at_once(routes, range(2), [0.0, 1.0], ENERGY, RATE_HZ) == 0.0
