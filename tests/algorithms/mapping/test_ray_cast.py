"""Rays on floors with glass and mirrors, on a grid of 0.1 m cells."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from robrain.algorithms.mapping.ray_cast import (
    GLASS_X,
    MIRROR_EAST,
    MIRROR_NORTH,
    MIRROR_SOUTH,
    MIRROR_WEST,
    SOLID,
    cast_rays,
)
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry

GEOMETRY = GridGeometry(0.1, -1.0, -2.0, 40, 30)
NOTHING = np.zeros(GEOMETRY.shape, np.bool_)
NO_CIRCLES = np.empty((0, 3))
AHEAD = np.array([0.0])
SENSOR = Pose2D(0.05, -0.55, 0.0)


def marched_m(
    occupied: np.ndarray, sensor: Pose2D, angle_rad: float, range_max_m: float, circles: np.ndarray, step_m: float
) -> float:
    """The first of many small steps that lies in an obstacle."""
    along_m = np.arange(0.0, range_max_m, step_m)
    x_m = sensor.x_m + along_m * math.cos(sensor.yaw_rad + angle_rad)
    y_m = sensor.y_m + along_m * math.sin(sensor.yaw_rad + angle_rad)
    rows = np.floor((y_m - GEOMETRY.origin_y_m) / GEOMETRY.resolution_m).astype(int) + 1
    columns = np.floor((x_m - GEOMETRY.origin_x_m) / GEOMETRY.resolution_m).astype(int) + 1
    closed = np.pad(occupied, 1, constant_values=True)
    blocked = closed[np.clip(rows, 0, closed.shape[0] - 1), np.clip(columns, 0, closed.shape[1] - 1)]
    for center_x_m, center_y_m, radius_m in circles:
        blocked |= np.hypot(x_m - center_x_m, y_m - center_y_m) <= radius_m
    hits = np.flatnonzero(blocked)
    return float(along_m[hits[0]]) if hits.size else range_max_m


def obstacle_apart_m(occupied: np.ndarray, x_m: float, y_m: float, circles: np.ndarray) -> float:
    """Distance from a place to the nearest obstacle's surface or inside, the closed edge of the arena included."""
    rows, columns = np.nonzero(np.pad(occupied, 1, constant_values=True))
    low_x_m = GEOMETRY.origin_x_m + (columns - 1) * GEOMETRY.resolution_m
    low_y_m = GEOMETRY.origin_y_m + (rows - 1) * GEOMETRY.resolution_m
    gap_x_m = np.maximum(0.0, np.maximum(low_x_m - x_m, x_m - low_x_m - GEOMETRY.resolution_m))
    gap_y_m = np.maximum(0.0, np.maximum(low_y_m - y_m, y_m - low_y_m - GEOMETRY.resolution_m))
    rims_m = np.hypot(circles[:, 0] - x_m, circles[:, 1] - y_m) - circles[:, 2]
    return float(min(np.hypot(gap_x_m, gap_y_m).min(), rims_m.min(initial=np.inf)))


@settings(deadline=None, max_examples=60)
@example(seed=47436, x_m=0.0, y_m=0.0, yaw_rad=0.0)  # on a corner of four cells, one of them occupied
@given(
    seed=st.integers(0, 2**32 - 1),
    x_m=st.floats(-0.95, 2.95),
    y_m=st.floats(-1.95, 0.95),
    yaw_rad=st.floats(-4.0, 4.0),
)
def test_ranges_agree_with_marching_in_small_steps(seed: int, x_m: float, y_m: float, yaw_rad: float) -> None:
    rng = np.random.default_rng(seed)
    occupied = rng.random(GEOMETRY.shape) < 0.05
    occupied[GEOMETRY.cell_of(x_m, y_m)] = False
    circles = np.column_stack((rng.uniform(-1, 3, 3), rng.uniform(-2, 1, 3), rng.uniform(0.05, 0.2, 3)))
    circles = circles[np.hypot(circles[:, 0] - x_m, circles[:, 1] - y_m) > circles[:, 2]]
    sensor = Pose2D(x_m, y_m, yaw_rad)
    angles_rad = rng.uniform(-math.pi, math.pi, 8)
    ranges_m = cast_rays(occupied, GEOMETRY, sensor, angles_rad, 2.0, circles)
    for angle_rad, range_m in zip(angles_rad, ranges_m, strict=True):
        # Marching may step over a corner that the ray clips, so: nothing before the range, and something at it.
        assert marched_m(occupied, sensor, angle_rad, 2.0, circles, 0.0005) >= range_m - 1e-9
        if range_m < 2.0:
            end_x_m = x_m + range_m * math.cos(yaw_rad + angle_rad)
            end_y_m = y_m + range_m * math.sin(yaw_rad + angle_rad)
            assert obstacle_apart_m(occupied, end_x_m, end_y_m, circles) < 1e-9


def test_arena_is_closed_at_its_edge() -> None:
    angles_rad = np.array([0.0, math.pi / 2, math.pi, -math.pi / 2])
    ranges_m = cast_rays(NOTHING, GEOMETRY, SENSOR, angles_rad, 9.0, NO_CIRCLES)
    assert ranges_m == pytest.approx([2.95, 1.55, 1.05, 1.45])


def test_circle_is_measured_to_its_rim_and_hides_what_is_behind_it() -> None:
    circles = np.array([[2.05, -0.55, 0.1], [1.05, -0.55, 0.2], [-0.75, -0.55, 0.2], [0.5, 0.5, 0.2]])
    assert cast_rays(NOTHING, GEOMETRY, SENSOR, AHEAD, 9.0, circles)[0] == pytest.approx(0.8)


@pytest.mark.parametrize("sensor", [Pose2D(-5.0, 0.0, 0.0), Pose2D(2.95, 0.95, 0.0)])
def test_sensor_outside_or_in_a_wall_measures_zero(sensor: Pose2D) -> None:
    occupied = NOTHING.copy()
    occupied[29, 39] = True
    assert cast_rays(occupied, GEOMETRY, sensor, AHEAD, 9.0, NO_CIRCLES)[0] == 0.0


ECHO_RAD = 0.2
MIRRORS = SOLID | MIRROR_WEST | MIRROR_EAST | MIRROR_SOUTH | MIRROR_NORTH


def floor(x_m=None, surface=SOLID, cells=1):
    """A floor with a wall of `cells` cells along y, at x, of one surface."""
    surfaces = np.zeros(GEOMETRY.shape, np.uint8)
    if x_m is not None:
        column = GEOMETRY.cell_of(x_m + 0.01, 0.0)[1]
        surfaces[:, column : column + cells] = surface
    return surfaces


def cast(surfaces, *angles_rad, sensor=SENSOR, circles=NO_CIRCLES, range_max_m=9.0, echo_rad=ECHO_RAD):
    return cast_rays(surfaces, GEOMETRY, sensor, np.array(angles_rad), range_max_m, circles, echo_rad)


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), yaw_rad=st.floats(-4.0, 4.0))
@pytest.mark.slow
def test_on_solid_walls_ranges_are_those_of_the_quick_kernel(seed, yaw_rad):
    rng = np.random.default_rng(seed)
    occupied = rng.random(GEOMETRY.shape) < 0.05
    sensor = Pose2D(SENSOR.x_m, SENSOR.y_m, yaw_rad)
    circles = np.column_stack((rng.uniform(-1, 3, 3), rng.uniform(-2, 1, 3), rng.uniform(0.05, 0.2, 3)))
    angles_rad = np.linspace(-math.pi, math.pi, 40)
    for range_max_m in (1.5, 9.0):
        quick_m = cast_rays(occupied, GEOMETRY, sensor, angles_rad, range_max_m, circles)
        ranges_m = cast(occupied.astype(np.uint8), *angles_rad, sensor=sensor, circles=circles, range_max_m=range_max_m)
        assert np.array_equal(ranges_m, quick_m)


@pytest.mark.parametrize("cells", [1, 3])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_pane_returns_beams_near_its_normal_and_lets_others_pass(cells, side):
    surfaces = floor(1.0, SOLID | GLASS_X, cells)
    surfaces[:, -1] = SOLID
    inside_rad, outside_rad = side * (ECHO_RAD - 0.01), side * (ECHO_RAD + 0.01)
    ranges_m = cast(surfaces, 0.0, inside_rad, outside_rad)
    assert ranges_m[0] == pytest.approx(0.95)
    assert ranges_m[1] == pytest.approx(0.95 / math.cos(inside_rad))
    assert ranges_m[2] == pytest.approx(2.85 / math.cos(outside_rad))


@pytest.mark.parametrize(
    ("yaw_rad", "mirror_m", "across_m"),
    [(0.0, 2.85, 3.8), (math.pi, 0.95, 3.8), (math.pi / 2, 1.45, 2.8), (-math.pi / 2, 1.35, 2.8)],
)
def test_beam_is_thrown_back_once_and_a_second_mirror_is_a_wall(yaw_rad, mirror_m, across_m):
    surfaces = np.zeros(GEOMETRY.shape, np.uint8)
    for edge in (surfaces[0, :], surfaces[-1, :], surfaces[:, 0], surfaces[:, -1]):
        edge[:] = MIRRORS
    sensor = Pose2D(SENSOR.x_m, SENSOR.y_m, yaw_rad)
    path_m = mirror_m + across_m
    assert cast(surfaces, 0.0, 0.05, sensor=sensor) == pytest.approx([path_m, path_m / math.cos(0.05)])


def test_beam_off_a_mirror_has_the_length_of_its_whole_way():
    surfaces = floor(1.0, SOLID | MIRROR_WEST)
    surfaces[GEOMETRY.cell_of(0.0, 0.61)[0], :] = SOLID
    slant_rad = math.atan2(1.15, 1.5)  # 0.95 m ahead to the mirror, 0.55 m back, 1.15 m to the left
    assert cast(surfaces, slant_rad) == pytest.approx([math.hypot(1.15, 1.5)])
