"""Coverage in turn, and tours, of a mote field."""

import itertools
import math

from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.motes.collect_tour import shortest_order, stops_for, tour_m
from robrain.algorithms.motes.coverage import CoverageMap, duty_set
from robrain.protocol.model.geometry import Point2D
from tests.algorithms.motes.fields import ORIGIN

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
