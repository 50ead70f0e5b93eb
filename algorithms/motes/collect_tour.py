"""Tours on which a robot collects the stored readings of motes."""

import math
from collections.abc import Sequence
from itertools import pairwise

import msgspec

from robrain.protocol.model.geometry import Point2D

LEAST_GAIN_M = 1e-9


class TourStop(msgspec.Struct, frozen=True):
    """A place of a tour, and the motes that the robot serves there."""

    place: Point2D
    motes: tuple[int, ...]


def stops_for(places: Sequence[Point2D], motes: Sequence[int], reach_m: float) -> list[TourStop]:
    """Few stops, each at a mote, from which all these motes are within reach; in the order of their gains.

    Greedy: the place with the most motes that have no stop yet comes first, of several that of the first mote.
    """
    near = {mote: {other for other in motes if places[mote].distance_m(places[other]) <= reach_m} for mote in motes}
    left, stops = set(motes), []
    while left:
        best = max(motes, key=lambda mote: (len(near[mote] & left), -mote))
        stops.append(TourStop(places[best], tuple(sorted(near[best] & left))))
        left -= near[best]
    return stops


def shortest_order(start: Point2D, places: Sequence[Point2D]) -> list[int]:
    """Order in which to visit places on a round trip from `start`: the nearest next, then 2-opt until nothing helps.

    Croes, A Method for Solving Traveling-Salesman Problems, Operations Research 6(6), 1958.
    """
    left, order, here = set(range(len(places))), [], start
    while left:
        following = min(left, key=lambda index: (here.distance_m(places[index]), index))
        left.remove(following)
        order.append(following)
        here = places[following]
    improved = True
    while improved:
        improved = False
        for first in range(len(order) - 1):
            for last in range(first + 1, len(order)):
                before = places[order[first - 1]] if first else start
                after = places[order[last + 1]] if last + 1 < len(order) else start
                old_m = before.distance_m(places[order[first]]) + places[order[last]].distance_m(after)
                new_m = before.distance_m(places[order[last]]) + places[order[first]].distance_m(after)
                if new_m < old_m - LEAST_GAIN_M:
                    order[first : last + 1] = reversed(order[first : last + 1])
                    improved = True
    return order


def tour_m(start: Point2D, places: Sequence[Point2D]) -> float:
    """Length of the round trip over places in this order."""
    corners = [start, *places, start]
    return sum(one.distance_m(other) for one, other in pairwise(corners))


def visit_weight(age_s: float, age_wanted_s: float, left_s: float = math.inf) -> float:
    """How much a visit to a mote is worth: 1 when its data are as old as wanted, more beyond it.

    Args:
        age_s: of the oldest reading that no robot has.
        age_wanted_s: how old data may become.
        left_s: how long the mote still lives; its data die with it, so that a visit in time is worth twice as much.

    >>> visit_weight(1800.0, 3600.0), visit_weight(7200.0, 3600.0), visit_weight(3600.0, 3600.0, left_s=600.0)
    (0.25, 4.0, 2.0)
    """
    weight = (age_s / age_wanted_s) ** 2
    return 2.0 * weight if left_s < age_wanted_s else weight
