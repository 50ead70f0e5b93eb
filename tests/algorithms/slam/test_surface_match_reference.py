"""`match_surface` against its definition, at many places on several floors."""

import math

import numpy as np
import pytest

from robrain.algorithms.localization.scan_match import ScanFit
from robrain.algorithms.localization.surface_match import DEGENERATE, INFORMATION_MIN, match_surface
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.slam.loop_closure import moved
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from tests.algorithms.mapping.lidar_floor import (
    ANGLES_RAD,
    CORRIDOR,
    CORRIDOR_PLACES,
    GEOMETRY,
    NOBODY,
    RANGE_M,
    ROOM,
    ROOM_PLACES,
    LidarFloor,
)
from tests.algorithms.slam.surface_reference import fit_of, lies

EDGES = LidarFloor((0, 0, 12, 0.06), (0, 0, 0.06, 8), (0, 7.94, 12, 8), (11.94, 0, 12, 8), (5.0, 3.0, 6.1, 4.3))
"""Walls in the outermost cells of the map."""
EDGE_PLACES = [Pose2D(x, y, 0.2 * x) for x in (1.0, 4.0, 8.0, 11.0) for y in (1.1, 5.2, 7.2)]
SLANTED = LidarFloor(
    *((0.1 * n, 0.06 * n + 1.0, 0.1 * n + 0.3, 0.06 * n + 1.3) for n in range(100)),
    *((6.0 + 0.1 * n, 7.8 - 0.1 * n, 6.3 + 0.1 * n, 8.0 - 0.1 * n) for n in range(50)),
)


SHIFTED = GridGeometry(0.1, -1.3, -0.9, 140, 100)


def mapped(floor: LidarFloor, places: list[Pose2D], geometry: GridGeometry = GEOMETRY) -> OccupancyGrid:
    """A map whose walls were first seen with growing drift."""
    grid = OccupancyGrid(geometry, surfaces=True)
    for number, place in enumerate(places, 1):
        drift = 0.01 * number, 0.001 * number
        grid.integrate_scan(place, ANGLES_RAD, floor.ranges_m(place), RANGE_M, number, NOBODY, drift)
    return grid


FLOORS = {
    "room": (ROOM, mapped(ROOM, ROOM_PLACES, SHIFTED)),
    "seen often": (ROOM, mapped(ROOM, 4 * ROOM_PLACES)),
    "edges": (EDGES, mapped(EDGES, EDGE_PLACES)),
    "slanted": (SLANTED, mapped(SLANTED, [Pose2D(x, 5.0, 0.1 * x) for x in (1.0, 3.0, 5.0, 7.0, 9.0)])),
    "corridor": (CORRIDOR, mapped(CORRIDOR, CORRIDOR_PLACES)),
    "seen once": (ROOM, mapped(ROOM, ROOM_PLACES[4:5])),
}
CASES = [
    (name, Pose2D(x_m, y_m, yaw_rad), wrong)
    for name, places in {
        "room": [(1.2, 1.3, 0.3), (2.4, 4.7, -2.0), (4.6, 1.0, 1.9), (6.9, 5.0, 3.0)],
        "seen often": [(1.2, 4.3, 0.3), (4.6, 5.0, -2.0), (6.9, 1.0, 1.0)],
        "edges": [(1.0, 1.0, 0.5), (11.1, 7.1, -2.5), (4.1, 5.5, 2.0), (10.8, 1.2, 0.0)],
        "slanted": [(3.1, 5.2, 0.4), (6.0, 5.5, -1.0)],
        "corridor": [(4.4, 4.2, 0.1), (7.0, 3.6, 2.8)],
        "seen once": [(2.2, 3.3, 0.2), (2.6, 3.9, -1.2)],
    }.items()
    for x_m, y_m, yaw_rad in places
    for wrong in ((0.06, -0.04, 0.03), (-0.09, 0.02, -0.05), (0.02, 0.11, 0.0))
]


def found_from(name: str, true: Pose2D, wrong: tuple[float, float, float]) -> tuple[ScanFit, Pose2D]:
    floor, grid = FLOORS[name]
    guess = Pose2D(true.x_m + wrong[0], true.y_m + wrong[1], true.yaw_rad + wrong[2])
    fit, _ = match_surface(grid, guess, floor.points(true))
    return fit, moved(guess, fit)


@pytest.mark.parametrize(("name", "true", "wrong"), CASES)
def test_at_the_place_found_the_beams_pull_nowhere_that_they_hold_and_tell_how_they_hold(
    name: str, true: Pose2D, wrong: tuple[float, float, float]
) -> None:
    floor, grid = FLOORS[name]
    fit, place = found_from(name, true, wrong)
    expected = lies(grid, place, floor.points(true))
    values = np.linalg.eigvalsh(expected.information)
    holds = values >= max(DEGENERATE * expected.used, INFORMATION_MIN)
    assert len(fit.directions) == np.count_nonzero(holds)
    per_m = 1.0 / GEOMETRY.resolution_m
    for direction, value in zip(fit.directions, values[holds], strict=True):
        assert direction.information == pytest.approx(value, rel=0.03)
        vector = np.array((*direction.row[:2], direction.row[2] * per_m / expected.lever))
        assert np.linalg.norm(vector) == pytest.approx(1.0, rel=1e-6)
        assert expected.information @ vector == pytest.approx(value * vector, abs=0.03 * values[-1])
        assert vector @ expected.pull / value == pytest.approx(0.0, abs=0.02), "in cells"


@pytest.mark.parametrize(("name", "true", "wrong"), CASES)
def test_the_offsets_are_those_of_the_true_place(name: str, true: Pose2D, wrong: tuple[float, float, float]) -> None:
    fit, _ = found_from(name, true, wrong)
    for direction in fit.directions:
        assert direction.offset_m == pytest.approx(-float(np.dot(direction.row, wrong)), abs=0.03)


@pytest.mark.parametrize(
    ("name", "true", "wrong"), [case for case in CASES if case[0] not in {"corridor", "seen once"}]
)
def test_the_fit_counts_the_beams_that_end_near_a_wall_and_how_unsure_those_walls_are(
    name: str, true: Pose2D, wrong: tuple[float, float, float]
) -> None:
    floor, grid = FLOORS[name]
    guess = Pose2D(true.x_m + wrong[0], true.y_m + wrong[1], true.yaw_rad + wrong[2])
    points = floor.points(true)
    fit, drift = match_surface(grid, guess, points)
    share, known, m2, rad2 = fit_of(grid, moved(guess, fit), points)
    assert (fit.fit, fit.beams) == (pytest.approx(share, abs=0.011), pytest.approx(known, abs=1))
    assert drift == (pytest.approx(m2, rel=0.01), pytest.approx(rad2, rel=0.01))


def test_a_guess_that_is_wrong_by_three_cells_is_put_right() -> None:
    for bearing_rad in np.linspace(-math.pi, math.pi, 8, endpoint=False).tolist():
        true = Pose2D(2.2, 3.3, 0.2)
        wrong = 0.25 * math.cos(bearing_rad), 0.25 * math.sin(bearing_rad), 0.08
        _, place = found_from("room", true, wrong)
        assert place.distance_m(true) < 0.01
