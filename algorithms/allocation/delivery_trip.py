"""Order of the stops of one robot that picks up and delivers several items on a trip.

Cheapest insertion, then items and single stops are taken out and inserted again while that shortens the trip.
Heuristics for pickup and delivery build on this insertion of pairs (S. Ropke, D. Pisinger, An Adaptive Large
Neighborhood Search Heuristic for the Pickup and Delivery Problem with Time Windows, Transportation Science 40, 2006).
"""

import itertools
from collections.abc import Iterable, Iterator, Sequence


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

    def is_possible(trip: Sequence[int]) -> bool:
        """Whether it begins with stop 0, each pick-up is before its drop-off, and no load exceeds the capacity."""
        load_kg, loaded = 0.0, set[int]()
        for stop in trip:
            load_kg += payloads_kg[stop // 2] * (1 if stop % 2 == 0 else -1)
            if load_kg > capacity_kg * (1 + 1e-9) or (stop % 2 and stop - 1 not in loaded):
                return False
            loaded.add(stop)
        return trip[0] == 0

    def shortest(tried: Iterable[list[int]], otherwise: list[int]) -> list[int]:
        best, best_m = otherwise, length_m(otherwise)
        for trip in tried:
            if (trip_m := length_m(trip)) < best_m - 1e-9 and is_possible(trip):
                best, best_m = trip, trip_m
        return best

    def with_item(trip: list[int], item: int) -> Iterator[list[int]]:
        for first in range(len(trip) + 1):
            for last in range(first, len(trip) + 1):
                yield [*trip[:first], 2 * item, *trip[first:last], 2 * item + 1, *trip[last:]]

    def with_stop(trip: list[int], stop: int) -> Iterator[list[int]]:
        for position in range(len(trip) + 1):
            yield [*trip[:position], stop, *trip[position:]]

    trip = [0, 1]
    for item in range(1, len(payloads_kg)):
        trip = shortest(with_item(trip, item), [*trip, 2 * item, 2 * item + 1])
    while True:
        before = trip
        for item in range(len(payloads_kg)):
            trip = shortest(with_item([stop for stop in trip if stop // 2 != item], item), trip)
        for moved in range(2 * len(payloads_kg)):
            trip = shortest(with_stop([stop for stop in trip if stop != moved], moved), trip)
        if trip == before:
            return trip
