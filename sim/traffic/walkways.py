"""Ways around the walls of a floor, for people."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from robrain.protocol.model.geometry import Point2D
from robrain.sim.maps.floor_plan import FloorPlan

PITCH_M = 0.15
"""Distance between neighbouring points of the lattice that ways are found on."""
STRAIGHT, DIAGONAL = 5, 7
"""Lengths of its edges: whole numbers, so that sums are exact and the ways the same on every processor."""
SAMPLE_M = 0.05
"""Distance between the points of a straight line at which its clearance is checked."""


class Walkways:
    """Shortest ways for a round body on a floor.

    Args:
        plan: the floor; doors count as open.
        radius_m: of the body; ways keep it clear of walls.

    """

    def __init__(self, plan: FloorPlan, radius_m: float) -> None:
        self._plan = plan
        self._radius_m = radius_m
        self._step = max(1, round(PITCH_M / plan.resolution_m))
        free = plan.clearance_m[:: self._step, :: self._step] >= radius_m
        self._shape = free.shape
        self._free = free
        self._graph = _graph(free)

    def way(self, start: Point2D, end: Point2D) -> list[Point2D] | None:
        """Corners of the shortest way, from start to end; None if there is none."""
        begin, goal = self._node(start), self._node(end)
        if begin is None or goal is None:
            return None
        lengths, before = dijkstra(self._graph, directed=False, indices=np.array([begin]), return_predecessors=True)
        if not math.isfinite(lengths[0, goal]):
            return None
        nodes = [goal]
        while nodes[-1] != begin:
            nodes.append(int(before[0, nodes[-1]]))
        points = [start, *(self._place(node) for node in reversed(nodes)), end]
        return self._pulled(points)

    def has_room(self, place: Point2D) -> bool:
        """Whether the body fits there."""
        return self._clear(place, place)

    def is_clear(self, start: Point2D, end: Point2D) -> bool:
        """Whether the body can move there in a straight line."""
        return self._clear(start, end)

    def _node(self, place: Point2D) -> int | None:
        """The nearest point of the lattice that is reached in a straight line."""
        if not self.has_room(place):
            return None
        row, column = self._plan.cell_of(place.x_m, place.y_m)
        middle_row, middle_column = row // self._step, column // self._step
        near = []
        for at_row in range(middle_row - 2, middle_row + 4):
            for at_column in range(middle_column - 2, middle_column + 4):
                if 0 <= at_row < self._shape[0] and 0 <= at_column < self._shape[1] and self._free[at_row, at_column]:
                    node = at_row * self._shape[1] + at_column
                    near.append((place.distance_m(self._place(node)), node))
        return next((node for _, node in sorted(near) if self._clear(place, self._place(node))), None)

    def _place(self, node: int) -> Point2D:
        row, column = divmod(node, self._shape[1])
        return self._plan.centre_of(row * self._step, column * self._step)

    def _pulled(self, points: list[Point2D]) -> list[Point2D]:
        """The way without the corners that a straight line can leave out."""
        pulled, at = [points[0]], 0
        while at < len(points) - 1:
            ahead = len(points) - 1
            while ahead > at + 1 and not self._clear(points[at], points[ahead]):
                ahead -= 1
            pulled.append(points[ahead])
            at = ahead
        return pulled

    def _clear(self, start: Point2D, end: Point2D) -> bool:
        plan = self._plan
        samples = max(2, math.ceil(start.distance_m(end) / SAMPLE_M) + 1)
        share = np.linspace(0.0, 1.0, samples)
        columns = np.floor((start.x_m + share * (end.x_m - start.x_m) - plan.origin_x_m) / plan.resolution_m)
        rows = np.floor((start.y_m + share * (end.y_m - start.y_m) - plan.origin_y_m) / plan.resolution_m)
        height, width = plan.occupied.shape
        if min(rows.min(), columns.min()) < 0 or rows.max() >= height or columns.max() >= width:
            return False
        return bool(plan.clearance_m[rows.astype(np.int64), columns.astype(np.int64)].min() >= self._radius_m)


def _graph(free: NDArray[np.bool_]) -> csr_array:
    """Edges between neighbouring free points; a diagonal one needs both points beside it to be free."""
    numbers = np.arange(free.size).reshape(free.shape)
    sides = [
        (numbers[:, :-1], numbers[:, 1:], free[:, :-1] & free[:, 1:], STRAIGHT),
        (numbers[:-1], numbers[1:], free[:-1] & free[1:], STRAIGHT),
    ]
    square = free[:-1, :-1] & free[1:, 1:] & free[:-1, 1:] & free[1:, :-1]
    sides += [
        (numbers[:-1, :-1], numbers[1:, 1:], square, DIAGONAL),
        (numbers[:-1, 1:], numbers[1:, :-1], square, DIAGONAL),
    ]
    ones = np.concatenate([one[there] for one, _, there, _ in sides])
    others = np.concatenate([other[there] for _, other, there, _ in sides])
    lengths = np.concatenate([np.full(int(there.sum()), float(length)) for _, _, there, length in sides])
    return csr_array(coo_array((lengths, (ones, others)), shape=(free.size, free.size)))
