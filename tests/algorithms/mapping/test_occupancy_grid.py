"""`OccupancyGrid` against its definition, on whatever is scanned."""

import math
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.slam.map_overlap import wall_points
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from tests.algorithms.mapping.grid_reference import GridReference
from tests.algorithms.slam.test_map_overlap import WIDE

GEOMETRY = GridGeometry(0.1, -1.0, -2.0, 40, 30)
NOBODY = np.empty((0, 3))
AHEAD = np.array([0.0])
MIDDLE = Pose2D(1.05, -0.55, 0.0)
"""In the middle of row 14, column 20."""


def look(grid: OccupancyGrid, range_m: float, *, stamp_ms: int = 0, ignore: np.ndarray = NOBODY) -> int:
    return grid.integrate_scan(MIDDLE, AHEAD, np.array([range_m]), 1.5, stamp_ms, ignore)


def say(grid: OccupancyGrid, value: int, stamp_ms: int) -> int:
    return grid.merge_patch(14, 23, np.array([[value]], np.int8), stamp_ms)


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


COARSE = GridGeometry(0.2, -1.0, 0.6, 24, 17)
RANGE_M = 3.0


def drawn_scan(rng, *, outside=0.5):
    """A scan from anywhere, also from beyond the grid; beams that return nothing, or nonsense, are among its own."""
    low, high = (
        (COARSE.origin_x_m - outside, COARSE.origin_y_m - outside),
        (3.8 + outside, 4.0 + outside),
    )
    x_m, y_m = rng.uniform(low, high)
    count = int(rng.integers(0, 25))
    ranges_m = rng.uniform(0.05, 1.1 * RANGE_M, count)
    ranges_m[rng.random(count) < 0.1] = rng.choice([math.inf, math.nan, 0.0, -1.0, RANGE_M])
    teammates = rng.uniform((-1.0, 0.6, 0.1), (3.8, 4.0, 0.5), (int(rng.integers(0, 3)), 3))
    sensor = Pose2D(float(x_m), float(y_m), float(rng.uniform(-3.1, 3.1)))
    drift = tuple(rng.uniform(0.0, 0.1, 2).tolist())
    return sensor, rng.uniform(-3.1, 3.1, count), ranges_m, RANGE_M, int(rng.integers(1, 1000)), teammates, drift


def repeated(rng, scan):
    """The same place and ranges once more, from a little beside: walls are hit again."""
    sensor, angles_rad, ranges_m, range_max_m, _, teammates, drift = scan
    dx_m, dy_m = rng.normal(0.0, 0.05, 2)
    beside = Pose2D(sensor.x_m + dx_m, sensor.y_m + dy_m, sensor.yaw_rad)
    return beside, angles_rad, ranges_m, range_max_m, int(rng.integers(1, 1000)), teammates, (drift[0] + 1.0, drift[1])


def assert_equal(grid, reference):
    assert np.array_equal(grid.log_odds, reference.array(reference.evidence))
    assert np.array_equal(grid.stamp_ms, reference.array(reference.stamp_ms))
    assert {tuple(cell) for cell in np.argwhere(grid.dirty).tolist()} == reference.dirty
    assert grid.known_count == len(reference.evidence)
    walls = {cell for cell, evidence in reference.evidence.items() if evidence > 0}
    for cell in walls:
        surface = reference.surfaces[cell]
        assert grid.surfaces.hits[cell] == surface.hits
        assert grid.surfaces.at[cell] == pytest.approx(surface.at, abs=1e-4)
        assert grid.surfaces.seen_along[cell] == pytest.approx(surface.view, abs=1e-4)
        assert grid.surfaces.drift[cell] == pytest.approx(surface.drift)
    assert {tuple(cell) for cell in grid.recent_surfaces().tolist()} == walls & reference.recent


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 100_000), st.lists(st.sampled_from(["scan", "again", "stretch", "contradict"]), max_size=12))
def test_whatever_is_scanned_the_grid_is_as_defined(seed, events):
    rng = np.random.default_rng(seed)
    grid, reference = OccupancyGrid(COARSE, surfaces=True), GridReference(COARSE)
    scan = drawn_scan(rng)
    for event in ["scan", *events]:
        version = grid.version
        if event in {"scan", "again"}:
            scan = drawn_scan(rng) if event == "scan" else repeated(rng, scan)
            changed = grid.integrate_scan(*scan)
            assert changed == reference.scan(*scan)
            assert (grid.version > version) == (changed > 0)
        elif event == "stretch":
            known = grid.known_count
            grid.begin_stretch()
            reference.begin_stretch()
            assert (grid.version > version) == (grid.known_count < known)
        else:
            others = rng.choice(np.array((-60, -1, 0, 1, 60), np.int8), (14, 30))
            row, column = int(rng.integers(-3, 6)), int(rng.integers(-5, 6))
            grid.contradict(others, row, column)
            reference.contradict(others, row, column)
        assert_equal(grid, reference)


def test_a_box_that_is_erased_is_as_if_never_seen():
    rng = np.random.default_rng(3)
    grid = OccupancyGrid(COARSE, surfaces=True)
    for _ in range(6):
        grid.integrate_scan(*drawn_scan(rng, outside=0.0))
    before, version = grid.classes(), grid.version
    known = int(np.count_nonzero(before[4:9, 3:11] != UNKNOWN))
    assert known > 10
    assert grid.erase(4, 3, 9, 11) == known
    after = before.copy()
    after[4:9, 3:11] = UNKNOWN
    assert np.array_equal(grid.classes(), after)
    assert grid.known_count == np.count_nonzero(after != UNKNOWN)
    assert grid.version == version + 1
    assert not grid.stamp_ms[4:9, 3:11].any()
    assert not grid.dirty[4:9, 3:11].any()
    assert grid.dirty.any()
    assert grid.erase(4, 3, 9, 11) == 0
    assert grid.version == version + 1, "there was nothing left to erase"


def test_the_middles_of_occupied_cells_are_the_points():
    grid = OccupancyGrid(WIDE)
    grid.merge_patch(100, 120, np.array([[OCCUPIED, FREE], [UNKNOWN, OCCUPIED]], np.int8), 10)
    assert wall_points(grid) == pytest.approx(np.array([(0.05, -1.95), (0.15, -1.85)]))


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
