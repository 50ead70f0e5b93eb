"""The order of a trip's stops, against all orders."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.allocation.delivery_trip import trip_order

places = st.tuples(st.floats(0, 20), st.floats(0, 20))
items = st.lists(st.tuples(places, places, st.floats(0, 10)), min_size=1, max_size=3)


def lengths_of(items):
    stops = [place for start, end, _ in items for place in (start, end)]
    return [[math.dist(one, other) for other in stops] for one in stops]


def length_m(trip, lengths_m):
    return sum(lengths_m[start][end] for start, end in itertools.pairwise(trip))


def is_possible(trip, payloads_kg):
    load_kg = 0.0
    for number, stop in enumerate(trip):
        if stop % 2 and stop - 1 not in trip[:number]:
            return False
        load_kg += payloads_kg[stop // 2] * (-1 if stop % 2 else 1)
        if load_kg > 10.0 + 1e-6:
            return False
    return trip[0] == 0


@pytest.mark.slow
@given(items)
def test_a_trip_is_possible_and_hardly_longer_than_the_shortest(items):
    payloads_kg, lengths_m = [payload_kg for _, _, payload_kg in items], lengths_of(items)
    trip = trip_order(payloads_kg, 10.0, lengths_m)
    assert sorted(trip) == list(range(2 * len(items)))
    assert is_possible(trip, payloads_kg)
    orders = itertools.permutations(range(2 * len(items)))
    shortest_m = min(length_m(order, lengths_m) for order in orders if is_possible(order, payloads_kg))
    assert length_m(trip, lengths_m) <= 2.0 * shortest_m + 1e-6


def test_items_on_the_way_are_picked_up_together_if_they_fit():
    lengths_m = lengths_of([((0, 0), (10, 0), 4.0), ((5, 0), (15, 0), 4.0)])
    assert trip_order([4.0, 4.0], 10.0, lengths_m) == [0, 2, 1, 3]
    assert trip_order([6.0, 6.0], 10.0, lengths_m) == [0, 1, 2, 3]
