"""Order of the stops of one robot that picks up and delivers several items on a trip.

Cheapest insertion, then each item is taken out and inserted again while that shortens the trip. Heuristics for pickup
and delivery build on this insertion of pairs (S. Ropke, D. Pisinger, An Adaptive Large Neighborhood Search Heuristic
for the Pickup and Delivery Problem with Time Windows, Transportation Science 40, 2006).
"""

import itertools
import math
from collections.abc import Sequence


def trip_order(payloads_kg: Sequence[float], capacity_kg: float, lengths_m: Sequence[Sequence[float]]) -> list[int]:
    """Stops in the order in which to drive them; the first is the pick-up of the first item.

    Stop 2·i is where item i is picked up, and stop 2·i + 1 where it goes. No load exceeds the capacity; no item may
    exceed it alone.

    Args:
        payloads_kg: (N,) of the items.
        capacity_kg: of the robot.
        lengths_m: (2 N, 2 N) lengths of the paths from stop to stop.

    """

    def length_m(trip: Sequence[int]) -> float:
        return sum(lengths_m[start][end] for start, end in itertools.pairwise(trip))

    def is_within_capacity(trip: Sequence[int]) -> bool:
        load_kg = 0.0
        for stop in trip:
            load_kg += payloads_kg[stop // 2] * (1 if stop % 2 == 0 else -1)
            if load_kg > capacity_kg * (1 + 1e-9):
                return False
        return True

    def with_item(trip: list[int], item: int) -> list[int]:
        """The shortest trip with an item more; the first stop stays the first."""
        found, best_m = [*trip, 2 * item, 2 * item + 1], math.inf
        for first in range(1, len(trip) + 1):
            for last in range(first, len(trip) + 1):
                tried = [*trip[:first], 2 * item, *trip[first:last], 2 * item + 1, *trip[last:]]
                tried_m = length_m(tried)
                if tried_m < best_m - 1e-9 and is_within_capacity(tried):
                    found, best_m = tried, tried_m
        return found

    def with_first(trip: list[int]) -> list[int]:
        """The shortest trip with the first item's drop-off, in a trip that has only its pick-up."""
        tries = [[*trip[:last], 1, *trip[last:]] for last in range(1, len(trip) + 1)]
        return min((tried for tried in tries if is_within_capacity(tried)), key=length_m)

    trip = [0, 1]
    for item in range(1, len(payloads_kg)):
        trip = with_item(trip, item)
    while True:
        before_m = length_m(trip)
        for item in range(len(payloads_kg)):
            rest = [stop for stop in trip if stop // 2 != item or stop == 0]
            tried = with_item(rest, item) if item else with_first(rest)
            if length_m(tried) < length_m(trip) - 1e-9:
                trip = tried
        if length_m(trip) >= before_m - 1e-9:
            return trip
