"""Which motes hear each other and the sink: a graph of links, or one over their places."""

import math
from collections.abc import Collection, Sequence

from robrain.protocol.model.geometry import Point2D


class LinkGraph:
    """Motes 0 to n − 1 and the sink, node n, with the links between them, which go both ways.

    Args:
        neighbours: of each node, in ascending order; those of the sink are the last.

    """

    def __init__(self, neighbours: list[list[int]]) -> None:
        self.neighbours = neighbours
        """Of each node, in ascending order."""
        self.sink = len(neighbours) - 1

    def reachable(self, alive: Collection[int] | None = None) -> set[int]:
        """Motes that reach the sink over living motes (all if None)."""
        usable = set(range(self.sink)) if alive is None else set(alive)
        found: set[int] = set()
        waiting = [self.sink]
        while waiting:
            for other in self.neighbours[waiting.pop()]:
                if other in usable and other not in found:
                    found.add(other)
                    waiting.append(other)
        return found


class RadioGraph(LinkGraph):
    """A graph whose nodes hear each other up to a distance.

    Args:
        places: of the motes, arena frame.
        sink: where readings leave the field, arena frame.
        range_m: distance up to which two nodes hear each other.

    """

    def __init__(self, places: Sequence[Point2D], sink: Point2D, range_m: float) -> None:
        self.places = [*places, sink]
        """The sink's is the last."""
        self.range_m = range_m
        nodes = range(len(self.places))
        super().__init__(
            [[other for other in nodes if other != node and self.distance_m(node, other) <= range_m] for node in nodes]
        )

    def distance_m(self, one: int, other: int) -> float:
        """Between two nodes."""
        a, b = self.places[one], self.places[other]
        return math.hypot(a.x_m - b.x_m, a.y_m - b.y_m)

    def parts(self, alive: Collection[int] | None = None) -> list[list[int]]:
        """Connected parts of the living motes and the sink, that of the sink first, the others by their least node."""
        usable = set(range(self.sink)) if alive is None else set(alive)
        first = sorted([self.sink, *self.reachable(usable)])
        left = usable.difference(first)
        parts = [first]
        while left:
            found = {min(left)}
            waiting = list(found)
            while waiting:
                new = [other for other in self.neighbours[waiting.pop()] if other in left and other not in found]
                found.update(new)
                waiting += new
            left -= found
            parts.append(sorted(found))
        return parts
