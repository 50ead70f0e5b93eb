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


def candidate(x_m, y_m, unknown_m2=1.0):
    return FrontierCandidate(Point2D(x_m, y_m), 1.0, unknown_m2)


def seeker(name, x_m, y_m, *avoided):
    return Seeker(name, Point2D(x_m, y_m), tuple(Point2D(*place) for place in avoided))


def assign_frontiers(navigation, candidates, seekers, taken):
    busy = [Busy(goal, goal) for goal in taken]
    return joint(Situation(candidates, seekers, busy, FrontierPaths(navigation, candidates).costs_m))


def goals(choices):
    return {choice.robot: (choice.place.x_m, choice.place.y_m) for choice in choices}


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
