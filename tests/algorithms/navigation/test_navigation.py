import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.navigation.navigation_grid import NavigationGrid
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry

GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 60, 40)
NEEDED_M = 0.25
SNAP_M = 0.5
WEST, EAST = Point2D(1.05, 2.05), Point2D(5.05, 2.05)


def hall():
    """A walled hall of 6 × 4 m."""
    classes = np.full(GEOMETRY.shape, FREE, np.int8)
    classes[[0, -1], :] = OCCUPIED
    classes[:, [0, -1]] = OCCUPIED
    return classes


def navigation(classes):
    return NavigationGrid(classes, GEOMETRY, NEEDED_M)


def along(start, path, step_m=0.02):
    """Places on the straight lines from waypoint to waypoint."""
    places, before = [], start
    for point in path:
        steps = max(1, round(math.dist((before.x_m, before.y_m), (point.x_m, point.y_m)) / step_m))
        for number in range(1, steps + 1):
            share = number / steps
            places.append(
                (before.x_m + share * (point.x_m - before.x_m), before.y_m + share * (point.y_m - before.y_m))
            )
        before = point
    return places


def length_m(start, path):
    points = [(start.x_m, start.y_m), *((point.x_m, point.y_m) for point in path)]
    return sum(math.dist(a, b) for a, b in pairwise(points))


def test_on_open_floor_the_way_is_straight_and_ends_at_the_goal():
    path = navigation(hall()).path(WEST, EAST, snap_m=SNAP_M)
    assert path[-1] == Point2D(pytest.approx(EAST.x_m), pytest.approx(EAST.y_m))
    assert length_m(WEST, path) == pytest.approx(4.0, abs=0.05)


def test_a_path_leaves_out_the_cell_that_the_robot_stands_in():
    path = navigation(hall()).path(WEST, EAST, snap_m=SNAP_M)
    assert all(point != WEST for point in path)


def test_who_is_there_already_has_one_waypoint_there():
    assert len(navigation(hall()).path(WEST, WEST, snap_m=SNAP_M)) == 1


def test_where_there_is_room_a_path_keeps_away_from_walls():
    classes = hall()
    classes[18:23, 20:40] = OCCUPIED
    grid = navigation(classes)
    path = grid.path(WEST, EAST, snap_m=SNAP_M)
    beside = [abs(y_m - 2.05) for x_m, y_m in along(WEST, path) if 2.2 < x_m < 3.8]
    assert min(beside) > 0.25 + NEEDED_M + 0.1


@pytest.mark.slow
@settings(max_examples=30)
@given(st.lists(st.tuples(st.floats(-2, 8), st.floats(-2, 6), st.floats(0, 3)), max_size=3))
def test_the_cells_left_are_those_whose_middles_lie_outside_all_circles(circles):
    grid = navigation(hall())
    left = grid.without(circles)
    for row, column in np.argwhere(grid.traversable):
        middle = GEOMETRY.center_of(row, column)
        distances = [(math.dist((middle.x_m, middle.y_m), (x_m, y_m)), radius) for x_m, y_m, radius in circles]
        if any(abs(distance - radius) < 1e-9 for distance, radius in distances):
            continue
        assert left[row, column] == all(distance > radius for distance, radius in distances)
    assert not np.any(left & ~grid.traversable)


def test_a_goal_in_a_wall_is_approached_as_near_as_the_robot_can_stand():
    path = navigation(hall()).path(WEST, Point2D(5.95, 2.05), snap_m=SNAP_M)
    assert 5.5 < path[-1].x_m < 5.95 - NEEDED_M + GEOMETRY.resolution_m


@pytest.mark.parametrize(
    ("start", "goal"),
    [
        (WEST, Point2D(20.0, 2.0)),  # far outside of the map
        (Point2D(-5.0, 2.0), EAST),  # a robot that is not on the map
        (WEST, Point2D(3.05, 2.05)),  # amid a block that is thicker than the snap
    ],
)
def test_what_is_too_far_from_where_a_robot_can_stand_has_no_path(start, goal):
    classes = hall()
    classes[12:29, 22:39] = OCCUPIED
    assert navigation(classes).path(start, goal, snap_m=SNAP_M) is None


def test_ways_are_metres_on_open_floor_and_infinite_where_there_is_none():
    classes = hall()
    classes[:, 40:] = UNKNOWN
    grid = navigation(classes)
    near, beyond, here = (
        GEOMETRY.cell_of(3.05, 2.05),
        GEOMETRY.cell_of(EAST.x_m, EAST.y_m),
        GEOMETRY.cell_of(WEST.x_m, WEST.y_m),
    )
    assert grid.costs_m(WEST, [near, beyond, here], snap_m=SNAP_M) == [pytest.approx(2.0, abs=0.2), math.inf, 0.0]
    assert grid.costs_m(EAST, [near], snap_m=SNAP_M) == [math.inf]


@settings(max_examples=30)
@given(st.data())
def test_no_path_ever_leaves_the_floor_that_may_be_driven_on(data):
    classes = hall()
    for _ in range(data.draw(st.integers(0, 5))):
        row, column = data.draw(st.integers(1, 34)), data.draw(st.integers(1, 54))
        classes[row : row + 4, column : column + 4] = data.draw(st.sampled_from([OCCUPIED, UNKNOWN]))
    grid = navigation(classes)
    path = grid.path(WEST, EAST, snap_m=SNAP_M)
    if path is None:
        return
    first = path[0]
    for x_m, y_m in along(first, path[1:]):
        assert grid.traversable[GEOMETRY.cell_of(x_m, y_m)]


def divided(*doors):
    """The hall with a wall at x = 3 that has doors; each starts at a row and has a number of cells."""
    classes = hall()
    classes[:, 30] = OCCUPIED
    for row, cells in doors:
        classes[row : row + cells, 30] = FREE
    return classes


def squeezing(classes):
    return NavigationGrid(classes, GEOMETRY, 0.12, preferred_m=0.28)


def test_a_narrow_door_is_passable_only_when_squeezing():
    classes = divided((19, 3))
    assert NavigationGrid(classes, GEOMETRY, 0.28).path(WEST, EAST, snap_m=SNAP_M) is None
    path = squeezing(classes).path(WEST, EAST, snap_m=SNAP_M)
    assert any(abs(x - 3.05) < 0.1 and abs(y - 2.05) < 0.06 for x, y in along(WEST, path)), "through its middle"


def test_a_wide_door_is_preferred_to_a_narrow_one_that_is_nearer():
    path = squeezing(divided((19, 3), (4, 8))).path(WEST, EAST, snap_m=SNAP_M)
    assert all(y < 1.2 for x, y in along(WEST, path) if 2.9 < x < 3.2)


def test_a_squeezing_robot_keeps_its_preferred_clearance_where_there_is_room():
    classes = divided((4, 8))
    wide = NavigationGrid(classes, GEOMETRY, 0.28)
    narrow = squeezing(classes)
    assert narrow.path(WEST, EAST, snap_m=SNAP_M) == wide.path(WEST, EAST, snap_m=SNAP_M)
    assert not narrow.narrow[wide.traversable].any()


def test_no_way_is_measured_through_a_narrow_place_that_is_shut():
    grid = squeezing(divided((19, 3), (4, 3)))
    east = GEOMETRY.cell_of(EAST.x_m, EAST.y_m)
    both, other, neither = (
        grid.costs_m(WEST, [east], snap_m=SNAP_M, shut=shut)[0]
        for shut in ([], [(3.0, 2.0, 0.6)], [(3.0, 2.0, 0.6), (3.0, 0.6, 0.6)])
    )
    assert both < other < neither == math.inf


def test_wide_places_stay_open_within_what_is_shut():
    grid = squeezing(divided((15, 10)))
    east = GEOMETRY.cell_of(EAST.x_m, EAST.y_m)
    assert grid.costs_m(WEST, [east], snap_m=SNAP_M, shut=[(3.0, 2.0, 0.6)])[0] < math.inf


def test_ways_through_narrow_places_are_not_measured_through_a_slanting_wall():
    """On cells of twice the size, a diagonal wall near robots would leak."""
    classes = hall()
    for row in range(1, 39):
        classes[row, row + 10] = OCCUPIED
    grid = squeezing(classes)
    assert grid.costs_m(WEST, [GEOMETRY.cell_of(EAST.x_m, EAST.y_m)], snap_m=SNAP_M) == [math.inf]


@pytest.mark.parametrize("options", [{}, {"unknown_cost": 3.0}, {"preferred_m": 0.4}])
def test_updated_grid_is_the_one_that_would_be_built_anew(options):
    draw = np.random.default_rng(6)
    classes = hall()
    grid = NavigationGrid(classes.copy(), GEOMETRY, NEEDED_M, **options)
    for _ in range(12):
        row, column = draw.integers(0, 38), draw.integers(0, 56)
        part = np.s_[row : row + int(draw.integers(1, 4)), column : column + int(draw.integers(1, 6))]
        classes[part] = draw.choice([FREE, OCCUPIED, UNKNOWN])
        grid.update(classes.copy())
        anew = NavigationGrid(classes, GEOMETRY, NEEDED_M, **options)
        assert np.array_equal(grid.traversable, anew.traversable)
        assert np.array_equal(grid.cost, anew.cost)
        assert np.array_equal(grid.narrow, anew.narrow)
