import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.exploration.situation import Busy, FrontierCandidate, FrontierPaths, Seeker, Situation
from robrain.algorithms.exploration.strategies import (
    CROWD_PENALTY_M,
    CROWD_RADIUS_M,
    GAIN_M_PER_M2,
    joint,
)
from robrain.algorithms.navigation.navigation_grid import NavigationGrid
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry

GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 100, 60)
NEEDED_M = 0.28


def floor(*walls):
    """Open floor of 10 × 6 m; walls are boxes x0, y0, x1, y1 in metres."""
    classes = np.full(GEOMETRY.shape, FREE, np.int8)
    for box in walls:
        x0, y0, x1, y1 = (round(10 * edge_m) for edge_m in box)
        classes[y0:y1, x0:x1] = OCCUPIED
    return NavigationGrid(classes, GEOMETRY, NEEDED_M)


OPEN = floor()
PARTED = floor((5.0, 0.0, 5.2, 6.0))


def candidate(x_m, y_m, unknown_m2=1.0):
    return FrontierCandidate(Point2D(x_m, y_m), 1.0, unknown_m2)


def seeker(name, x_m, y_m, *avoided):
    return Seeker(name, Point2D(x_m, y_m), tuple(Point2D(*place) for place in avoided))


def assign_frontiers(navigation, candidates, seekers, taken):
    busy = [Busy(goal, goal) for goal in taken]
    return joint(Situation(candidates, seekers, busy, FrontierPaths(navigation, candidates).costs_m))


def goals(choices):
    return {choice.robot: (choice.place.x_m, choice.place.y_m) for choice in choices}


def cost_matrix(navigation, candidates, seekers, taken):
    """Cost of each pair alone, None where the robot may not or cannot go there."""
    matrix = []
    for one in seekers:
        pairs = [assign_frontiers(navigation, [other], [one], taken) for other in candidates]
        matrix.append([pair[0].cost_m if pair else None for pair in pairs])
    return matrix


def best_by_trying_all(matrix):
    """Most pairs, and of those the least sum."""
    rows, columns = len(matrix), len(matrix[0])
    best = (0, 0.0)
    for picked in itertools.product([None, *range(columns)], repeat=rows):
        used = [column for column in picked if column is not None]
        if len(used) != len(set(used)):
            continue
        costs = [matrix[row][column] for row, column in enumerate(picked) if column is not None]
        if None in costs:
            continue
        key = (-len(costs), sum(costs))
        best = min(best, key)
    return -best[0], best[1]


PLACES = st.tuples(st.floats(0.5, 9.5), st.floats(0.5, 5.5))


@settings(max_examples=40, deadline=None)
@given(
    navigation=st.sampled_from([OPEN, PARTED, floor((3.0, 0.0, 3.2, 4.5), (6.5, 1.5, 6.7, 6.0))]),
    starts=st.lists(PLACES, min_size=1, max_size=4),
    ends=st.lists(st.tuples(PLACES, st.floats(0.4, 5.0)), min_size=1, max_size=6),
    taken=st.lists(PLACES, max_size=2),
    avoided=st.lists(PLACES, max_size=2),
)
def test_the_sum_of_costs_is_the_least_that_there_is(navigation, starts, ends, taken, avoided):
    seekers = [
        Seeker(f"r{number}", Point2D(*place), tuple(Point2D(*away) for away in avoided if number == 0))
        for number, place in enumerate(starts)
    ]
    candidates = [FrontierCandidate(Point2D(*place), 1.0, unknown_m2) for place, unknown_m2 in ends]
    busy = [Point2D(*place) for place in taken]
    choices = assign_frontiers(navigation, candidates, seekers, busy)
    pairs, least_m = best_by_trying_all(cost_matrix(navigation, candidates, seekers, busy))
    assert len(choices) == pairs
    assert sum(choice.cost_m for choice in choices) == pytest.approx(least_m, abs=1e-4)
    assert len({choice.robot for choice in choices}) == len(choices)


def test_the_cost_on_open_floor_is_the_way_less_the_unknown_floor_beyond():
    (choice,) = assign_frontiers(OPEN, [candidate(7.0, 3.0, 1.5)], [seeker("r1", 3.0, 3.0)], [])
    assert choice.cost_m == pytest.approx(4.0 - GAIN_M_PER_M2 * 1.5, abs=0.3)


@given(st.floats(0.0, 8.0))
@settings(max_examples=20, deadline=None)
def test_the_penalty_falls_off_with_the_distance_to_a_taken_goal(away_m):
    end, one = [candidate(1.0, 3.0)], [seeker("r1", 2.0, 3.0)]
    (free,), (crowded,) = (assign_frontiers(OPEN, end, one, taken) for taken in ([], [Point2D(1.0 + away_m, 3.0)]))
    expected_m = CROWD_PENALTY_M * max(0.0, 1.0 - away_m / CROWD_RADIUS_M)
    assert crowded.cost_m - free.cost_m == pytest.approx(expected_m, abs=1e-6)


def test_a_place_where_a_robot_failed_is_not_for_that_robot():
    ends = [candidate(4.0, 3.0)]
    assert assign_frontiers(OPEN, ends, [seeker("r1", 2.0, 3.0, (4.5, 3.0))], []) == []
    both = [seeker("r1", 2.0, 3.0, (4.5, 3.0)), seeker("r2", 9.0, 3.0)]
    assert goals(assign_frontiers(OPEN, ends, both, [])) == {"r2": (4.0, 3.0)}
