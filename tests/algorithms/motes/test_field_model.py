"""Coverage in turn, tours, relay places and the graph of a mote field."""

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.motes.collect_tour import shortest_order, stops_for, tour_m
from robrain.algorithms.motes.coverage import CoverageMap, duty_set
from robrain.algorithms.motes.field_life import relay_places
from robrain.algorithms.motes.routes import RadioGraph
from robrain.protocol.model.geometry import Point2D
from tests.algorithms.motes.fields import ORIGIN, line, scattered

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


def test_of_two_motes_at_one_place_the_fuller_is_on_duty() -> None:
    cover = CoverageMap([ORIGIN, ORIGIN], GRID, 15.0)
    assert duty_set(cover, {0: 0.5, 1: 0.6}) == [1]
    assert duty_set(cover, {0: 0.5, 1: 0.4}) == [0]


def test_share_that_is_covered_counts_each_point_once() -> None:
    cover = CoverageMap([ORIGIN, ORIGIN, Point2D(100.0, 100.0)], [ORIGIN, Point2D(50.0, 50.0)], 5.0)
    assert (cover.share([0]), cover.share([0, 1, 2]), cover.share([])) == (0.5, 0.5, 0.0)


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


@given(seed=st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_relays_connect_every_part(seed: int) -> None:
    graph = scattered(seed, motes=30, size_m=50.0)
    narrow = RadioGraph(graph.places[:-1], graph.places[-1], 9.0)
    relays = relay_places(narrow)
    whole = RadioGraph([*graph.places[:-1], *relays], graph.places[-1], 9.0 + 1e-9)
    assert len(whole.reachable()) == 30 + len(relays)


def test_relays_stand_on_the_gap_and_no_more_than_asked_for() -> None:
    graph = line(9.0, 36.0, 80.0)
    places_m = [place.x_m for place in relay_places(graph)]
    assert places_m == pytest.approx([18.0, 27.0, 44.8, 53.6, 62.4, 71.2])
    assert len(relay_places(graph, most=3)) == 2
    assert relay_places(line(9.0)) == []


def test_parts_of_a_field_are_told_apart() -> None:
    graph = line(9.0, 30.0, 35.0, 80.0)
    assert graph.parts() == [[0, 4], [1, 2], [3]]
    assert graph.parts({1, 2}) == [[4], [1, 2]]
