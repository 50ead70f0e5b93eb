"""Parts of the navigation grid against the same written in plain Python."""

import math

import numpy as np
import pytest

from robrain.algorithms.navigation.navigation_grid import COARSE, DEAR, NavigationGrid, Zone, _centre
from robrain.algorithms.navigation.path_planning import is_chord_clear
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry

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
    dear = grid._with_zones([Zone(positions, radius_m)]) - grid.cost
    for row in range(30):
        for column in range(40):
            place = grid.geometry.center_of(row, column)
            nearest_m = min(math.dist((place.x_m, place.y_m), position) for position in positions)
            if abs(nearest_m - radius_m) > ROUNDING:
                assert dear[row, column] == (DEAR if nearest_m < radius_m else 0.0), (row, column)


def test_zone_with_its_centre_on_a_border_row_reaches_it() -> None:
    grid = _grid(10, 10)
    corner = np.array([(-1.0 + 0.05, 0.5 + 0.05)])
    dear = grid._with_zones([Zone(corner, 0.05)]) - grid.cost
    assert np.argwhere(dear > 0.0).tolist() == [[0, 0]]


def _plainly_centred(path: np.ndarray, occupied: np.ndarray, traversable: np.ndarray, reach: float) -> np.ndarray:
    path = path.copy()
    walls = np.argwhere(occupied)
    steps = [(0.5 * i, 0.5 * j) for i in (-1, 0, 1) for j in (-1, 0, 1)]

    def room_2(place: np.ndarray) -> float:
        return float(min(((walls - place) ** 2).sum(axis=1).min(initial=np.inf), reach * reach))

    for k in range(len(path)):
        best = path[k].copy()
        for step in steps:
            if room_2(path[k] + step) > room_2(best) + ROUNDING:
                best = path[k] + step
        before, after = path[max(k - 1, 0)], path[min(k + 1, len(path) - 1)]
        if is_chord_clear(traversable, *before, *best) and is_chord_clear(traversable, *best, *after):
            path[k] = best
    return path


@pytest.mark.parametrize("seed", range(40))
def test_points_of_a_path_move_to_where_walls_are_farthest(seed: int) -> None:
    draw = np.random.default_rng(seed)
    occupied = draw.random((14, 17)) < 0.06
    traversable = ~occupied
    free = np.argwhere(traversable)
    path = free[draw.choice(len(free), 6)].astype(np.float64) + draw.choice([0.0, 0.25], (6, 2))
    reach_cells = float(draw.choice([1.5, 2.5, 3.0]))
    moved = path.copy()
    _centre(moved, occupied, traversable, reach_cells)
    assert moved.tolist() == _plainly_centred(path, occupied, traversable, reach_cells).tolist()


def test_point_between_two_walls_moves_to_their_middle() -> None:
    occupied = np.zeros((9, 9), np.bool_)
    occupied[2], occupied[7] = True, True
    path = np.array([(4.0, 4.0)])
    _centre(path, occupied, ~occupied, 3.0)
    assert path[0, 0] == 4.5


@pytest.mark.parametrize(("height", "width"), [(20, 30), (21, 30), (20, 31), (21, 31)])
def test_coarse_cell_takes_the_least_cost_of_its_cells_also_at_an_odd_border(height: int, width: int) -> None:
    draw = np.random.default_rng(height * width)
    grid = _grid(height, width, draw.random((height, width)) < 0.04)
    traversable, cost = grid._coarse
    assert traversable.shape == cost.shape == (-(-height // COARSE), -(-width // COARSE))
    for row in range(traversable.shape[0]):
        for column in range(traversable.shape[1]):
            part = np.s_[row * COARSE : (row + 1) * COARSE, column * COARSE : (column + 1) * COARSE]
            inside = grid.traversable[part]
            assert traversable[row, column] == inside.any()
            if inside.any():
                assert cost[row, column] == grid.cost[part][inside].min()


def test_ways_are_compared_at_twice_the_pitch_unless_there_are_narrow_places() -> None:
    classes = np.full((20, 20), FREE, np.int8)
    geometry = GridGeometry(RESOLUTION_M, 0.0, 0.0, 20, 20)
    start, cells = Point2D(0.25, 0.25), [(10, 10), (10, 11), (11, 10), (11, 11)]
    coarse = NavigationGrid(classes, geometry, 0.15).costs_m(start, cells, snap_m=0.3)
    fine = NavigationGrid(classes, geometry, 0.15, preferred_m=0.2).costs_m(start, cells, snap_m=0.3)
    assert len(set(coarse)) == 1
    assert len(set(fine)) == 3


def _middles(grid: NavigationGrid, cells: list[tuple[int, int]]) -> np.ndarray:
    middles = [grid.geometry.center_of(row, column) for row, column in cells]
    return np.array([(middle.x_m, middle.y_m) for middle in middles])


@pytest.mark.parametrize("cell", [(6, 4), (6, 8), (4, 6), (8, 6)])
def test_positions_are_clear_up_to_the_first_that_a_wall_on_any_side_is_too_near_to(cell: tuple[int, int]) -> None:
    classes = np.full((13, 13), FREE, np.int8)
    classes[cell] = OCCUPIED
    grid = NavigationGrid(classes, GridGeometry(RESOLUTION_M, -1.0, 0.5, 13, 13), 0.25)  # the wall is 0.2 m off
    assert grid.clear_positions(classes, _middles(grid, [(2, 2), (10, 2), (6, 6), (10, 10)])) == 2


def test_positions_are_as_far_from_the_maps_border_as_from_a_wall() -> None:
    grid = _grid(9, 7)  # 0.15 m are needed
    inside = [(1, 1), (1, 5), (7, 5), (7, 1)]
    assert grid.clear_positions(np.full((9, 7), FREE, np.int8), _middles(grid, inside)) == len(inside)
    for cell in ((0, 3), (8, 3), (4, 0), (4, 6)):
        assert grid.clear_positions(np.full((9, 7), FREE, np.int8), _middles(grid, [*inside, cell])) == len(inside)


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
