import math
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robrain.algorithms.mapping.occupancy_grid import LOG_ODDS_LIMIT, OccupancyGrid
from robrain.algorithms.mapping.ray_cast import cast_rays
from robrain.protocol.model.geometry import Point2D, Pose2D
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


def test_row_zero_is_at_the_lowest_y_and_cells_are_found_by_their_middle() -> None:
    assert GEOMETRY.shape == (30, 40)
    assert GEOMETRY.cell_of(-0.95, -1.95) == (0, 0)
    assert GEOMETRY.cell_of(-1.05, -2.15) == (-2, -1)
    middle = GEOMETRY.center_of(0, 0)
    assert middle == Point2D(pytest.approx(-0.95), pytest.approx(-1.95))
    assert GEOMETRY.contains(29, 39)
    assert not GEOMETRY.contains(30, 39)
    assert not GEOMETRY.contains(0, -1)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((0.0, 0.0, 0.0, 4, 4), "resolution_m"),
        ((math.nan, 0.0, 0.0, 4, 4), "resolution_m"),
        ((0.1, math.inf, 0.0, 4, 4), "origin"),
        ((0.1, 0.0, 0.0, 0, 4), "width"),
        ((0.1, 0.0, 0.0, 4, -1), "height"),
    ],
)
def test_geometry_without_cells_is_refused(arguments: tuple[float, float, float, int, int], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        GridGeometry(*arguments)


def test_one_beam_classifies_the_way_and_its_end() -> None:
    grid = OccupancyGrid(GEOMETRY)
    assert look(grid, 0.5, stamp_ms=7) == 6
    classes = grid.classes()
    assert (classes[14, 20:25] == FREE).all()
    assert classes[14, 25] == OCCUPIED
    assert np.count_nonzero(classes != UNKNOWN) == 6
    assert (grid.stamp_ms[14, 20:26] == 7).all()
    assert grid.known_count == np.count_nonzero(grid.known()) == 6
    assert grid.version == 1


@pytest.mark.parametrize("range_m", [1.5, 9.0, math.inf])
def test_miss_frees_the_way_up_to_the_maximum_range_only(range_m: float) -> None:
    grid = OccupancyGrid(GEOMETRY)
    look(grid, range_m)
    classes = grid.classes()
    assert (classes[14, 20:35] == FREE).all()
    assert grid.known_count == 15


@pytest.mark.parametrize("range_m", [math.nan, 0.0, -1.0])
def test_range_that_measures_nothing_says_nothing(range_m: float) -> None:
    grid = OccupancyGrid(GEOMETRY)
    assert look(grid, range_m) == 0
    assert grid.known_count == 0
    assert grid.version == 0


def test_team_mate_is_not_drawn_into_the_map() -> None:
    grid = OccupancyGrid(GEOMETRY)
    look(grid, 0.5, ignore=np.array([[1.7, -0.55, 0.2]]))
    assert (grid.classes()[14, 20:25] == FREE).all()
    assert not (grid.classes() == OCCUPIED).any()


@pytest.mark.parametrize("yaw_rad", [0.0, math.pi / 2, math.pi, -math.pi / 2])
def test_surface_on_a_border_marks_the_cell_behind_it(yaw_rad: float) -> None:
    grid = OccupancyGrid(GEOMETRY)
    sensor = Pose2D(MIDDLE.x_m, MIDDLE.y_m, yaw_rad)
    grid.integrate_scan(sensor, AHEAD, np.array([0.45]), 1.5, 0, NOBODY)
    row, column = 14 + 5 * round(math.sin(yaw_rad)), 20 + 5 * round(math.cos(yaw_rad))
    assert np.argwhere(grid.classes() == OCCUPIED).tolist() == [[row, column]]


def test_wall_seen_once_survives_a_few_beams_through_it_but_not_many() -> None:
    grid = OccupancyGrid(GEOMETRY)
    look(grid, 0.5)
    for _ in range(3):
        look(grid, 1.0)
        assert grid.classes()[14, 25] == OCCUPIED
    look(grid, 1.0)
    assert grid.classes()[14, 25] == FREE


def test_known_cell_stays_known_whatever_is_seen() -> None:
    grid = OccupancyGrid(GEOMETRY)
    rng = np.random.default_rng(1)
    known = grid.known()
    for _ in range(200):
        look(grid, float(rng.uniform(0.1, 1.6)))
        assert grid.known()[known].all()
        known = grid.known()
        assert np.abs(grid.log_odds.astype(int)).max() <= 100
        assert grid.known_count == np.count_nonzero(known)


def test_beam_does_not_free_what_another_of_the_same_scan_hit() -> None:
    grid = OccupancyGrid(GEOMETRY)
    for _ in range(50):
        grid.integrate_scan(MIDDLE, np.array([0.0, 0.0]), np.array([0.5, 1.2]), 1.5, 0, NOBODY)
    assert grid.log_odds[14, 25] == LOG_ODDS_LIMIT
    assert grid.classes()[14, 26] == FREE


def test_wall_seen_at_grazing_incidence_is_not_erased() -> None:
    # The wall's surface halves the cells of row 20: every grazing beam runs through some of them before it ends.
    fine = GridGeometry(0.05, -1.0, -2.0, 80, 60)
    world = np.zeros(fine.shape, np.bool_)
    world[41:45] = True
    grid = OccupancyGrid(GEOMETRY)
    angles_rad = np.linspace(-math.pi, math.pi, 180, endpoint=False)
    for x_m in np.arange(-0.7, 2.7, 0.2):
        sensor = Pose2D(float(x_m), -0.35, 0.0)
        grid.integrate_scan(sensor, angles_rad, cast_rays(world, fine, sensor, angles_rad, 4.0, NOBODY), 4.0, 0, NOBODY)
    walls = grid.classes() == OCCUPIED
    for _ in range(100):
        sensor = Pose2D(-0.95, -0.07, 0.0)
        ranges_m = cast_rays(world, fine, sensor, angles_rad, 4.0, NOBODY)
        grid.integrate_scan(sensor, angles_rad, ranges_m, 4.0, 1, NOBODY)
    assert walls[20, 2:38].all()
    assert (grid.classes()[walls] == OCCUPIED).all()


@settings(deadline=None, max_examples=60)
@given(
    x_m=st.floats(-1e7, 1e7) | st.floats(-3.0, 5.0),
    y_m=st.floats(-1e7, 1e7) | st.floats(-3.0, 3.0),
    yaw_rad=st.floats(-10.0, 10.0),
    ranges_m=arrays(np.float64, 12, elements=st.floats(width=64)),
)
def test_any_pose_and_any_ranges_are_survived(x_m: float, y_m: float, yaw_rad: float, ranges_m: np.ndarray) -> None:
    grid = OccupancyGrid(GEOMETRY)
    angles_rad = np.linspace(-3.0, 3.0, 12)
    grid.integrate_scan(Pose2D(x_m, y_m, yaw_rad), angles_rad, ranges_m, 4.0, 0, NOBODY)
    assert grid.known_count == np.count_nonzero(grid.known())


def test_scan_from_outside_still_maps_what_lies_inside() -> None:
    grid = OccupancyGrid(GEOMETRY)
    grid.integrate_scan(Pose2D(-1.55, -0.55, 0.0), AHEAD, np.array([1.0]), 3.0, 0, NOBODY)
    assert (grid.classes()[14, :4] == FREE).all()
    assert grid.classes()[14, 4] == OCCUPIED


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


def test_patch_without_a_statement_changes_nothing() -> None:
    grid = OccupancyGrid(GEOMETRY)
    say(grid, 100, 5)
    assert say(grid, -1, 9) == 0
    assert grid.classes()[14, 23] == OCCUPIED
    assert grid.version == 1


def test_patch_carries_one_map_into_another() -> None:
    teller, hearer = OccupancyGrid(GEOMETRY), OccupancyGrid(GEOMETRY)
    rng = np.random.default_rng(2)
    angles_rad = np.linspace(-math.pi, math.pi, 60, endpoint=False)
    for stamp_ms in range(5):
        teller.integrate_scan(MIDDLE, angles_rad, rng.uniform(0.2, 1.6, 60), 1.5, stamp_ms, NOBODY)
        patch = teller.pop_patch()
        assert patch is not None
        on_the_wire = np.frombuffer(patch.cells.tobytes(), np.int8).reshape(patch.cells.shape)
        hearer.merge_patch(patch.row, patch.column, on_the_wire, patch.stamp_ms)
        assert (hearer.classes() == teller.classes()).all()


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
