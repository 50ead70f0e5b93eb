"""Parts of the navigation grid against the same written in plain Python."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy import ndimage

from robrain.algorithms.navigation.clearance import least_gap_m, mapped_clearance_m
from robrain.algorithms.navigation.navigation_grid import DEAR, NavigationGrid, Swath, clearance_m
from robrain.algorithms.navigation.path_planning import plan_path, standpoint
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


def test_where_there_is_room_a_path_keeps_away_from_walls():
    classes = hall()
    classes[18:23, 20:40] = OCCUPIED
    grid = navigation(classes)
    path = grid.path(WEST, EAST, snap_m=SNAP_M)
    beside = [abs(y_m - 2.05) for x_m, y_m in along(WEST, path) if 2.2 < x_m < 3.8]
    assert min(beside) > 0.25 + NEEDED_M + 0.1


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


def test_no_way_is_measured_through_a_narrow_place_that_is_shut():
    grid = squeezing(divided((19, 3), (4, 3)))
    east = GEOMETRY.cell_of(EAST.x_m, EAST.y_m)
    both, other, neither = (
        grid.costs_m(WEST, [east], snap_m=SNAP_M, shut=shut)[0]
        for shut in ([], [(3.0, 2.0, 0.6)], [(3.0, 2.0, 0.6), (3.0, 0.6, 0.6)])
    )
    assert both < other < neither == math.inf


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


RESOLUTION_M = 0.1
ROUNDING = 1e-9


def _grid(height: int, width: int, walls: np.ndarray | None = None) -> NavigationGrid:
    classes = np.full((height, width), FREE, np.int8)
    if walls is not None:
        classes[walls] = OCCUPIED
    return NavigationGrid(classes, GridGeometry(RESOLUTION_M, -1.0, 0.5, width, height), 0.15)


@pytest.mark.parametrize("seed", range(10))
def test_zone_makes_exactly_the_cells_within_its_radius_dear(seed: int) -> None:
    draw = np.random.default_rng(seed)
    grid = _grid(30, 40)
    positions = draw.uniform((-1.5, 0.0), (3.5, 4.0), (3, 2))
    radius_m = float(draw.uniform(0.05, 0.8))
    dear = grid._with_swaths([Swath(positions, radius_m)]) - grid.cost
    for row in range(30):
        for column in range(40):
            place = grid.geometry.center_of(row, column)
            nearest_m = min(math.dist((place.x_m, place.y_m), position) for position in positions)
            if abs(nearest_m - radius_m) > ROUNDING:
                assert dear[row, column] == (DEAR if nearest_m < radius_m else 0.0), (row, column)


def _middles(grid: NavigationGrid, cells: list[tuple[int, int]]) -> np.ndarray:
    middles = [grid.geometry.center_of(row, column) for row, column in cells]
    return np.array([(middle.x_m, middle.y_m) for middle in middles])


@pytest.mark.parametrize("unknown_cost", [None, 3.0])
@pytest.mark.parametrize("seed", range(3))
def test_position_is_clear_if_all_within_the_needed_clearance_is(seed: int, unknown_cost: float | None) -> None:
    draw = np.random.default_rng(seed)
    height, width, needed_m = 14, 17, 0.25
    classes = draw.choice(np.array([FREE, OCCUPIED, UNKNOWN], np.int8), (height, width), p=(0.9, 0.04, 0.06))
    geometry = GridGeometry(RESOLUTION_M, -1.0, 0.5, width, height)
    grid = NavigationGrid(np.full((height, width), FREE, np.int8), geometry, needed_m, unknown_cost)
    walled = np.pad(classes, 3, constant_values=OCCUPIED)
    walls = np.argwhere(walled == OCCUPIED) - 3
    driven = (FREE,) if unknown_cost is None else (FREE, UNKNOWN)
    for row in range(height):
        for column in range(width):
            nearest_m = RESOLUTION_M * float(np.hypot(*(walls - (row, column)).T).min())
            is_clear = classes[row, column] in driven and nearest_m >= needed_m
            assert grid.clear_positions(classes, _middles(grid, [(row, column)])) == is_clear, (row, column)


@given(
    radius_m=st.floats(0.1, 0.4),
    wider_m=st.floats(0.0, 0.2),
    offset=st.floats(0.0, 1.0),
    resolution_m=st.sampled_from([0.05, 0.1]),
)
def test_no_gap_that_can_be_driven_is_missing_from_a_map(radius_m, wider_m, offset, resolution_m):
    """A corridor whose walls are not aligned with the cells; the cells that contain them are occupied."""
    low_m = (10 + offset) * resolution_m
    high_m = low_m + least_gap_m(radius_m) + wider_m
    classes = np.full((60, 60), FREE, np.int8)
    classes[: math.floor(low_m / resolution_m) + 1] = OCCUPIED
    classes[math.floor(high_m / resolution_m) :] = OCCUPIED
    grid = NavigationGrid(
        classes, GridGeometry(resolution_m, 0.0, 0.0, 60, 60), mapped_clearance_m(radius_m, resolution_m)
    )
    row = int(np.flatnonzero(grid.traversable[:, 30])[0])
    assert plan_path(grid.traversable, grid.cost, (row, 20), (row, 40)) is not None


@pytest.mark.slow
@settings(deadline=None)
@given(arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=15)), st.floats(0.05, 3.0))
def test_clearance_is_the_euclidean_distance_to_the_nearest_obstacle(occupied: np.ndarray, limit_m: float) -> None:
    closed = np.pad(occupied, 1, constant_values=True)
    expected = np.minimum(0.1 * ndimage.distance_transform_edt(~closed)[1:-1, 1:-1], limit_m)
    clearance = clearance_m(occupied, 0.1, limit_m)
    assert clearance.dtype == np.float32
    assert clearance == pytest.approx(expected, rel=1e-6)


def test_arena_edge_counts_as_an_obstacle() -> None:
    clearance = clearance_m(np.zeros((5, 7), np.bool_), 1.0, 10.0)
    assert clearance[2].tolist() == [1.0, 2.0, 3.0, 3.0, 3.0, 2.0, 1.0]


FLOOR = np.full((20, 20), FREE, np.int8)


def test_a_place_off_the_map_is_seen_from_its_edge_if_that_is_in_reach() -> None:
    assert standpoint(FLOOR, FLOOR == FREE, (-3, 5), 5) == (0, 5)
    assert standpoint(FLOOR, FLOOR == FREE, (-30, 5), 5) is None


@settings(max_examples=60, deadline=None)
@given(
    arrays(np.int8, (12, 12), elements=st.sampled_from([FREE, FREE, FREE, OCCUPIED, UNKNOWN])),
    arrays(np.bool_, (12, 12)),
    st.tuples(st.integers(0, 11), st.integers(0, 11)),
    st.integers(1, 8),
)
def test_a_standpoint_is_traversable_in_reach_and_none_in_plain_sight_is_nearer(classes, traversable, cell, reach):
    found = standpoint(classes, traversable, cell, reach)
    if found is not None:
        assert traversable[found]
        assert math.dist(found, cell) <= reach
    beside = [(cell[0] + step, cell[1]) for step in (-1, 0, 1) if 0 <= cell[0] + step < 12]
    for near in beside:  # nothing lies between these
        if traversable[near] and classes[near] != OCCUPIED and classes[cell] != OCCUPIED:
            assert found is not None
            assert math.dist(found, cell) <= math.dist(near, cell)
