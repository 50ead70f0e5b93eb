import math
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry

GEOMETRY = GridGeometry(0.1, -1.0, -2.0, 40, 30)
NOBODY = np.empty((0, 3))
AHEAD = np.array([0.0])
MIDDLE = Pose2D(1.05, -0.55, 0.0)
"""In the middle of row 14, column 20."""


def look(grid: OccupancyGrid, range_m: float, *, stamp_ms: int = 0, ignore: np.ndarray = NOBODY) -> int:
    return grid.integrate_scan(MIDDLE, AHEAD, np.array([range_m]), 1.5, stamp_ms, ignore)


def say(grid: OccupancyGrid, value: int, stamp_ms: int) -> int:
    return grid.merge_patch(14, 23, np.array([[value]], np.int8), stamp_ms)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"angles_rad": np.zeros(2)}, "angles"),
        ({"ignore": np.zeros(3)}, "ignore"),
        ({"sensor": Pose2D(math.nan, 0.0, 0.0)}, "pose"),
        ({"range_max_m": math.inf}, "range_max_m"),
        ({"stamp_ms": -1}, "stamp_ms"),
        ({"stamp_ms": 2**31}, "stamp_ms"),
    ],
)
def test_scan_that_does_not_fit_together_is_refused(change: dict[str, object], named: str) -> None:
    scan = {
        "sensor": MIDDLE,
        "angles_rad": np.zeros(1),
        "ranges_m": np.ones(1),
        "range_max_m": 2.0,
        "stamp_ms": 0,
        "ignore": NOBODY,
    }
    with pytest.raises(ValueError, match=named):
        OccupancyGrid(GEOMETRY).integrate_scan(**(scan | change))


def test_patch_tells_what_own_sensing_changed_and_tells_it_once() -> None:
    grid = OccupancyGrid(GEOMETRY)
    assert grid.pop_patch() is None
    look(grid, 0.5, stamp_ms=3)
    patch = grid.pop_patch()
    assert patch is not None
    assert (patch.row, patch.column, patch.stamp_ms) == (14, 20, 3)
    assert patch.cells.tolist() == [[0, 0, 0, 0, 0, 100]]
    look(grid, 0.5, stamp_ms=4)
    assert grid.pop_patch() is None


def test_cells_of_the_box_that_did_not_change_are_no_statement() -> None:
    grid = OccupancyGrid(GEOMETRY)
    grid.integrate_scan(MIDDLE, np.array([0.0, math.pi / 2]), np.array([0.3, 0.3]), 1.5, 0, NOBODY)
    patch = grid.pop_patch()
    assert patch is not None
    assert patch.cells.tolist() == [[0, 0, 0, 100], [0, -1, -1, -1], [0, -1, -1, -1], [100, -1, -1, -1]]


def test_team_mates_word_is_not_passed_on_as_ones_own() -> None:
    grid = OccupancyGrid(GEOMETRY)
    assert say(grid, 100, 5) == 1
    assert grid.pop_patch() is None
    assert grid.known_count == 1


def test_later_statement_wins_and_an_older_one_is_passed_over() -> None:
    grid = OccupancyGrid(GEOMETRY)
    assert say(grid, 100, 5) == 1
    assert say(grid, 0, 4) == 0
    assert grid.classes()[14, 23] == OCCUPIED
    assert say(grid, 0, 6) == 1
    assert grid.classes()[14, 23] == FREE
    assert say(grid, 100, 6) == 1
    assert grid.classes()[14, 23] == OCCUPIED
    assert grid.version == 3


@pytest.mark.parametrize(("row", "column"), [(-1, 0), (0, -1), (29, 0), (0, 38)])
def test_patch_that_leaves_the_grid_is_refused(row: int, column: int) -> None:
    with pytest.raises(ValueError, match=f"2 x 3 cells at row {row}, column {column} leaves the grid of 30 x 40"):
        OccupancyGrid(GEOMETRY).merge_patch(row, column, np.zeros((2, 3), np.int8), 0)


TINY = GridGeometry(1.0, 0.0, 0.0, 4, 3)
PATCHES = st.lists(
    st.tuples(
        st.integers(0, 1),
        st.integers(0, 2),
        arrays(np.int8, (2, 2), elements=st.sampled_from([-1, 0, 100])),
        st.integers(0, 3),
    ),
    min_size=1,
    max_size=4,
)


@settings(deadline=None)
@given(PATCHES)
def test_merge_does_not_depend_on_the_order_of_patches(
    patches: list[tuple[int, int, np.ndarray, int]],
) -> None:
    outcomes = set()
    for ordered in permutations(patches):
        grid = OccupancyGrid(TINY)
        for patch in ordered:
            grid.merge_patch(*patch)
        outcomes.add((grid.log_odds.tobytes(), grid.stamp_ms.tobytes(), grid.known_count))
    assert len(outcomes) == 1


@settings(deadline=None)
@given(PATCHES)
def test_patches_heard_again_change_nothing(patches: list[tuple[int, int, np.ndarray, int]]) -> None:
    grid = OccupancyGrid(TINY)
    for patch in patches:
        grid.merge_patch(*patch)
    before = (grid.log_odds.tobytes(), grid.stamp_ms.tobytes(), grid.version, grid.known_count)
    assert sum(grid.merge_patch(*patch) for patch in patches) == 0
    assert (grid.log_odds.tobytes(), grid.stamp_ms.tobytes(), grid.version, grid.known_count) == before


def test_a_cell_that_a_mate_has_seen_later_is_not_told_as_ones_own() -> None:
    grid = OccupancyGrid(GEOMETRY)
    look(grid, 0.5, stamp_ms=7)
    say(grid, OCCUPIED, 8)
    patch = grid.pop_patch()
    assert patch is not None
    assert (patch.row, patch.column) == (14, 20)
    assert patch.cells.tolist() == [[FREE, FREE, FREE, UNKNOWN, FREE, OCCUPIED]]
