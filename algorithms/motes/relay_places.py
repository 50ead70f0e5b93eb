"""Places for relays that connect the parts of a field with the sink."""

import math

from robrain.algorithms.motes.radio_graph import RadioGraph
from robrain.protocol.model.geometry import Point2D


def relay_places(graph: RadioGraph, alive: set[int] | None = None, most: int | None = None) -> list[Point2D]:
    """Places where relays connect every cut-off part of the field with the sink; as many per gap as it needs.

    The gaps are those of a minimum spanning tree over the parts (Prim), which relays on the straight line between the
    two nearest nodes bridge in equal steps: the heuristic for the fewest Steiner points with bounded edges (Lin and
    Xue, Information Processing Letters 69(2), 1999; at most four times as many as the best).

    Args:
        graph: who hears whom.
        alive: motes that live; all if None.
        most: places at the most; parts that would need more stay cut off, the nearest gaps come first.

    """
    first, *others = graph.parts(alive)
    joined, places = list(first), list[Point2D]()
    while others:
        distance_m, near, far, index = min(
            (graph.distance_m(one, other), one, other, number)
            for number, part in enumerate(others)
            for one in joined
            for other in part
        )
        needed = math.ceil(distance_m / graph.range_m) - 1
        if most is not None and len(places) + needed > most:
            break
        places += _between(graph.places[near], graph.places[far], needed)
        joined += others.pop(index)
    return places


def _between(one: Point2D, other: Point2D, count: int) -> list[Point2D]:
    shares = [step / (count + 1) for step in range(1, count + 1)]
    return [
        Point2D(one.x_m + share * (other.x_m - one.x_m), one.y_m + share * (other.y_m - one.y_m)) for share in shares
    ]
