"""`OccupancyGrid` against its definition, on whatever is scanned."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import UNKNOWN, GridGeometry
from tests.algorithms.mapping.grid_reference import GridReference

GEOMETRY = GridGeometry(0.2, -1.0, 0.6, 24, 17)
RANGE_M = 3.0
NOBODY = np.empty((0, 3))


def drawn_scan(rng, *, outside=0.5):
    """A scan from anywhere, also from beyond the grid; beams that return nothing, or nonsense, are among its own."""
    low, high = (GEOMETRY.origin_x_m - outside, GEOMETRY.origin_y_m - outside), (3.8 + outside, 4.0 + outside)
    x_m, y_m = rng.uniform(low, high)
    count = int(rng.integers(0, 25))
    ranges_m = rng.uniform(0.05, 1.1 * RANGE_M, count)
    ranges_m[rng.random(count) < 0.1] = rng.choice([math.inf, math.nan, 0.0, -1.0, RANGE_M])
    mates = rng.uniform((-1.0, 0.6, 0.1), (3.8, 4.0, 0.5), (int(rng.integers(0, 3)), 3))
    sensor = Pose2D(float(x_m), float(y_m), float(rng.uniform(-3.1, 3.1)))
    drift = tuple(rng.uniform(0.0, 0.1, 2).tolist())
    return sensor, rng.uniform(-3.1, 3.1, count), ranges_m, RANGE_M, int(rng.integers(1, 1000)), mates, drift


def repeated(rng, scan):
    """The same place and ranges once more, from a little beside: walls are hit again."""
    sensor, angles_rad, ranges_m, range_max_m, _, mates, drift = scan
    dx_m, dy_m = rng.normal(0.0, 0.05, 2)
    beside = Pose2D(sensor.x_m + dx_m, sensor.y_m + dy_m, sensor.yaw_rad)
    return beside, angles_rad, ranges_m, range_max_m, int(rng.integers(1, 1000)), mates, (drift[0] + 1.0, drift[1])


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
    grid, reference = OccupancyGrid(GEOMETRY, surfaces=True), GridReference(GEOMETRY)
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


@pytest.mark.parametrize("seed", range(12))
def test_what_is_told_again_is_what_was_seen_since_it_was_asked_last(seed):
    rng = np.random.default_rng(seed)
    grid, reference = OccupancyGrid(GEOMETRY, surfaces=True), GridReference(GEOMETRY)
    walls = np.full(GEOMETRY.shape, 60, np.int8)
    told = 0
    for scans in (1, 0, 2, 1, 0):
        for _ in range(scans):
            scan = drawn_scan(rng, outside=-0.5)
            grid.integrate_scan(*scan)
            reference.scan(*scan)
        grid.pop_patch()
        reference.dirty.clear()
        grid.contradict(walls, 0, 0)
        reference.contradict(walls, 0, 0)
        assert_equal(grid, reference)
        assert scans or not reference.dirty
        told += len(reference.dirty)
    assert told > 0


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 100_000))
def test_without_surfaces_the_cells_are_the_same(seed):
    rng = np.random.default_rng(seed)
    with_surfaces, without = OccupancyGrid(GEOMETRY, surfaces=True), OccupancyGrid(GEOMETRY)
    for _ in range(5):
        scan = drawn_scan(rng)
        with_surfaces.integrate_scan(*scan)
        without.integrate_scan(*scan)
    assert np.array_equal(with_surfaces.log_odds, without.log_odds)
    assert np.array_equal(with_surfaces.dirty, without.dirty)
    assert without.surfaces.hits.shape == (1, 1)


def test_of_many_beams_that_ended_in_a_cell_the_older_ones_fade():
    grid, reference = OccupancyGrid(GEOMETRY, surfaces=True), GridReference(GEOMETRY)
    for number in range(60):
        range_m = 1.01 if number < 40 else 1.15
        scan = (Pose2D(0.0, 2.0, 0.0), np.zeros(1), np.array([range_m]), RANGE_M, number + 1, NOBODY, (0.1, 0.2))
        grid.integrate_scan(*scan)
        reference.scan(*scan)
        assert_equal(grid, reference)
    assert grid.surfaces.hits.max() == 30


def test_a_box_that_is_erased_is_as_if_never_seen():
    rng = np.random.default_rng(3)
    grid = OccupancyGrid(GEOMETRY, surfaces=True)
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


def test_after_all_is_forgotten_the_grid_is_new():
    rng = np.random.default_rng(5)
    grid = OccupancyGrid(GEOMETRY, surfaces=True)
    for _ in range(4):
        grid.integrate_scan(*drawn_scan(rng))
    version = grid.version
    grid.forget()
    assert grid.version == version + 1
    assert grid.known_count == 0
    assert grid.pop_patch() is None
    assert len(grid.recent_surfaces()) == 0
    reference = GridReference(GEOMETRY)
    assert_equal(grid, reference)
    for _ in range(3):
        scan = drawn_scan(rng)
        grid.integrate_scan(*scan)
        reference.scan(*scan)
        assert_equal(grid, reference)


def test_cells_that_were_drawn_from_outside_are_counted():
    grid = OccupancyGrid(GEOMETRY)
    grid.count_drawn(5, 3)
    assert (grid.version, grid.known_count) == (1, 3)
    grid.count_drawn(0, 0)
    assert (grid.version, grid.known_count) == (1, 3)


@pytest.mark.parametrize("before", [1, 2, 5, 9])
def test_on_a_new_stretch_what_is_seen_again_is_told_once(before):
    grid, place = OccupancyGrid(GridGeometry(0.1, 0.0, 0.0, 40, 40)), Pose2D(2.0, 2.0, 0.0)

    def scan():
        angles_rad = np.linspace(-math.pi, math.pi, 60, endpoint=False)
        grid.integrate_scan(place, angles_rad, np.full(60, 1.5), 6.0, 7, np.empty((0, 3)))

    for _ in range(before):
        scan()
    first = grid.pop_patch()
    grid.begin_stretch()
    scan()
    again = grid.pop_patch()
    assert np.array_equal(first.cells, again.cells)
    for _ in range(3):
        scan()
        assert grid.pop_patch() is None
