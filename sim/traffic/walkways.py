"""Ways around the walls of a floor, for people."""

import heapq
import math

import numpy as np

from robrain.protocol.model.geometry import Point2D
from robrain.sim.maps.floor_plan import FloorPlan

PITCH_M = 0.15
"""Distance between neighbouring points of the lattice that ways are found on."""
STRAIGHT, DIAGONAL = 5, 7
"""Lengths of its edges: whole numbers, so that the order of equal ways does not depend on rounding."""
_STEPS = (
    (-1, 0, STRAIGHT), (0, -1, STRAIGHT), (0, 1, STRAIGHT), (1, 0, STRAIGHT),
    (-1, -1, DIAGONAL), (-1, 1, DIAGONAL), (1, -1, DIAGONAL), (1, 1, DIAGONAL),
)  # fmt: skip
Node = tuple[int, int]
"""Row and column of the lattice."""
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
        self._free = {(row, column) for row, column in np.argwhere(free).tolist()}

    def way(self, start: Point2D, end: Point2D) -> list[Point2D] | None:
        """Corners of the shortest way, from start to end; None if there is none."""
        begin, goal = self._node(start), self._node(end)
        if begin is None or goal is None:
            return None
        nodes = self._search(begin, goal)
        if not nodes:
            return None
        points = [start, *(self._place(node) for node in nodes), end]
        return self._pulled(points)

    def has_room(self, place: Point2D) -> bool:
        """Whether the body fits there."""
        return self._clear(place, place)

    def is_clear(self, start: Point2D, end: Point2D) -> bool:
        """Whether the body can move there in a straight line."""
        return self._clear(start, end)

    def _search(self, begin: Node, goal: Node) -> list[Node]:
        """Nodes of a shortest way, by A* (Hart, Nilsson and Raphael 1968); empty if there is none.

        A diagonal step needs both nodes beside it to be free.
        """
        best, before = {begin: 0}, {begin: begin}
        queue = [(_least(begin, goal), begin)]
        done: set[Node] = set()
        while queue:
            _, node = heapq.heappop(queue)
            if node == goal:
                nodes = [goal]
                while nodes[-1] != begin:
                    nodes.append(before[nodes[-1]])
                return nodes[::-1]
            if node in done:
                continue
            done.add(node)
            row, column = node
            for row_step, column_step, length in _STEPS:
                there = (row + row_step, column + column_step)
                sides = {(row + row_step, column), (row, column + column_step), there}
                if not sides <= self._free:
                    continue
                way = best[node] + length
                if way < best.get(there, way + 1):
                    best[there], before[there] = way, node
                    heapq.heappush(queue, (way + _least(there, goal), there))
        return []

    def _node(self, place: Point2D) -> Node | None:
        """The nearest node that is reached in a straight line."""
        if not self.has_room(place):
            return None
        row, column = self._plan.cell_of(place.x_m, place.y_m)
        middle_row, middle_column = row // self._step, column // self._step
        around = [(middle_row + up, middle_column + right) for up in range(-2, 4) for right in range(-2, 4)]
        near = sorted((place.distance_m(self._place(node)), node) for node in around if node in self._free)
        return next((node for _, node in near if self._clear(place, self._place(node))), None)

    def _place(self, node: Node) -> Point2D:
        row, column = node
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


def _least(one: Node, other: Node) -> int:
    """Length of a way between two nodes where there is nothing between them."""
    rows, columns = abs(one[0] - other[0]), abs(one[1] - other[1])
    return STRAIGHT * max(rows, columns) + (DIAGONAL - STRAIGHT) * min(rows, columns)
