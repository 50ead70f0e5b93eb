"""Whether a straight line between two places touches only cells that may be driven on."""

import heapq
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.navigation.path_planning import (
    distance_field,
    measured_field,
    nearest_traversable,
    plan_path,
    round_corners,
    shorten_path,
    steps_against,
)

OPEN = np.ones((12, 16), np.bool_)
EVEN = np.ones(OPEN.shape, np.float32)


def random_world(seed: int, *, even: bool = False) -> tuple[np.ndarray, np.ndarray, tuple[int, int], tuple[int, int]]:
    rng = np.random.default_rng(seed)
    traversable = rng.random(OPEN.shape) < rng.uniform(0.5, 1.0)
    cost = EVEN if even else rng.uniform(1.0, 5.0, OPEN.shape).astype(np.float32)
    ends = [(int(rng.integers(12)), int(rng.integers(16))) for _ in range(2)]
    for end in ends:
        traversable[end] = True
    return traversable, cost, ends[0], ends[1]


def length_cells(path: np.ndarray, traversable: np.ndarray, cost: np.ndarray) -> float:
    """Cost of a path, step by step, after checking that each step is allowed."""
    total = 0.0
    for (row, column), (next_row, next_column) in pairwise(path):
        assert max(abs(next_row - row), abs(next_column - column)) == 1
        assert traversable[row, column]
        assert traversable[next_row, next_column]
        assert traversable[row, next_column]
        assert traversable[next_row, column]
        length = math.hypot(next_row - row, next_column - column)
        total += length * 0.5 * (float(cost[row, column]) + float(cost[next_row, next_column]))
    return total


@settings(deadline=None, max_examples=150)
@given(st.integers(0, 2**32 - 1))
def test_path_costs_what_the_distance_field_says(seed: int) -> None:
    traversable, cost, start, goal = random_world(seed)
    field = distance_field(traversable, cost, np.array([goal]))
    path = plan_path(traversable, cost, start, goal)
    if path is None:
        assert math.isinf(field[start])
        return
    assert tuple(path[0]) == start
    assert tuple(path[-1]) == goal
    assert length_cells(path, traversable, cost) == pytest.approx(float(field[start]), rel=1e-5)


def cheapest(traversable: np.ndarray, cost: np.ndarray, source: tuple[int, int]) -> np.ndarray:
    """Dijkstra's algorithm with Python's heap."""
    distance = np.full(traversable.shape, math.inf)
    heap = [(0.0, source)]
    while heap:
        so_far, (row, column) = heapq.heappop(heap)
        if so_far >= distance[row, column]:
            continue
        distance[row, column] = so_far
        for to_row, to_column in ((row + i, column + j) for i in (-1, 0, 1) for j in (-1, 0, 1)):
            if 0 <= to_row < traversable.shape[0] and 0 <= to_column < traversable.shape[1]:
                corners = traversable[to_row, to_column] & traversable[row, to_column] & traversable[to_row, column]
                length = math.hypot(to_row - row, to_column - column)
                step = length * 0.5 * (float(cost[row, column]) + float(cost[to_row, to_column]))
                if corners:
                    heapq.heappush(heap, (so_far + step, (to_row, to_column)))
    return distance


@pytest.mark.slow
@settings(deadline=None, max_examples=33)
@given(st.integers(0, 2**32 - 1))
def test_distance_field_is_that_of_a_plain_dijkstra(seed: int) -> None:
    traversable, cost, source, _ = random_world(seed)
    field = distance_field(traversable, cost, np.array([source], np.int64))
    assert field == pytest.approx(cheapest(traversable, cost, source))


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_shortened_path_sees_from_corner_to_corner(seed: int) -> None:
    traversable, cost, start, goal = random_world(seed)
    path = plan_path(traversable, cost, start, goal)
    if path is None:
        return
    short = shorten_path(path, traversable)
    assert tuple(short[0]) == start
    assert tuple(short[-1]) == goal
    assert {tuple(cell) for cell in short} <= {tuple(cell) for cell in path}
    for (row, column), (to_row, to_column) in pairwise(short):
        rows = np.linspace(row, to_row, 400)
        columns = np.linspace(column, to_column, 400)
        assert traversable[np.rint(rows).astype(int), np.rint(columns).astype(int)].all()


def test_nearest_traversable_cell_is_found_within_its_radius() -> None:
    only = np.zeros((9, 9), np.bool_)
    only[1, 4] = only[4, 7] = only[8, 8] = True
    assert nearest_traversable(only, (4, 4), 3) == (1, 4)
    assert nearest_traversable(only, (4, 4), 2) is None
    assert nearest_traversable(only, (5, 5), 4) == (4, 7)
    assert nearest_traversable(only, (8, 8), 0) == (8, 8)
    assert nearest_traversable(only, (11, 8), 3) == (8, 8)


def test_corner_is_cut_twice_each_time_at_a_quarter_of_its_shorter_side() -> None:
    open_floor = np.ones((20, 20), np.bool_)
    rounded = round_corners(np.array([[0, 0], [0, 12], [16, 12]], np.int32), open_floor)
    # First from (0, 9) to (3, 12); then each of these by a quarter of the 3·√2 between them.
    back = 0.75 * math.sqrt(2.0)
    expected = [(0, 0), (0, 9 - back), (0.75, 9.75), (2.25, 11.25), (3 + back, 12), (16, 12)]
    assert rounded == pytest.approx(np.array(expected))


def test_corner_is_kept_if_its_sides_are_short_or_the_cut_would_leave_the_floor() -> None:
    short = np.array([[0, 0], [0, 2], [2, 2]], np.int32)
    assert round_corners(short, np.ones((20, 20), np.bool_)).tolist() == short.tolist()
    corridor = np.zeros((20, 20), np.bool_)
    corridor[0], corridor[:, 12] = True, True
    bent = np.array([[0, 0], [0, 12], [16, 12]], np.int32)
    assert round_corners(bent, corridor).tolist() == bent.tolist()


@pytest.mark.parametrize("direction_rad", [0.0, 0.5, math.pi / 2, 2.5, math.pi])
def test_no_step_leads_against_a_one_way_area(direction_rad):
    """A band across the middle; above row 12 is a way round it."""
    mask = np.zeros((20, 30), np.bool_)
    mask[:12, 10:20] = True
    shut_steps = steps_against([(mask, direction_rad)], mask.shape)
    free, cost = np.ones(mask.shape, np.bool_), np.ones(mask.shape, np.float32)
    for start, goal in (((5, 2), (5, 27)), ((5, 27), (5, 2)), ((5, 27), (5, 19)), ((5, 2), (5, 10))):
        path = plan_path(free, cost, start, goal, shut_steps)
        assert path is not None
        for one, other in pairwise(path.tolist()):
            along = (other[1] - one[1]) * math.cos(direction_rad) + (other[0] - one[0]) * math.sin(direction_rad)
            assert along > -1e-6 or not (mask[tuple(one)] or mask[tuple(other)])
    forth, back = (plan_path(free, cost, *ends, shut_steps) for ends in (((5, 2), (5, 27)), ((5, 27), (5, 2))))
    assert (mask[tuple(forth.T)].any(), mask[tuple(back.T)].any()) == (
        math.cos(direction_rad) > -1e-6,
        math.cos(direction_rad) < 1e-6,
    )


def test_lengths_are_measured_along_the_cheapest_paths():
    """The cheap way round is 17 cells longer than the way through, whose cells cost nothing extra when measured."""
    free, ones = np.ones((9, 20), np.bool_), np.ones((9, 20), np.float32)
    cost = ones.copy()
    cost[:, 8:12] = 5.0
    source = np.array([(4, 0)])
    field = distance_field(free, cost, source)
    assert field[4, 19] > 30
    assert measured_field(field, free, cost, ones)[4, 19] == 19.0
    cost[0, 8:12] = 1.0
    through_gap = measured_field(distance_field(free, cost, source), free, cost, ones)[4, 19]
    assert through_gap == pytest.approx(distance_field(free, cost, source)[4, 19], rel=1e-6)
    assert through_gap > 19.0
