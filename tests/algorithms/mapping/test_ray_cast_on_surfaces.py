"""Rays on floors with glass and mirrors, on a grid of 0.1 m cells."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.mapping.ray_cast import (
    GLASS_X,
    GLASS_Y,
    MIRROR_EAST,
    MIRROR_NORTH,
    MIRROR_SOUTH,
    MIRROR_WEST,
    SOLID,
    cast_rays,
    cast_rays_on_surfaces,
)
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry

GEOMETRY = GridGeometry(0.1, -1.0, -2.0, 40, 30)
SENSOR = Pose2D(0.05, -0.55, 0.0)
NO_CIRCLES = np.empty((0, 3))
ECHO_RAD = 0.2
MIRRORS = SOLID | MIRROR_WEST | MIRROR_EAST | MIRROR_SOUTH | MIRROR_NORTH


def floor(x_m=None, surface=SOLID, cells=1):
    """A floor with a wall along y of so many cells from x, all of one surface."""
    surfaces = np.zeros(GEOMETRY.shape, np.uint8)
    if x_m is not None:
        column = GEOMETRY.cell_of(x_m + 0.01, 0.0)[1]
        surfaces[:, column : column + cells] = surface
    return surfaces


def cast(surfaces, *angles_rad, sensor=SENSOR, circles=NO_CIRCLES, range_max_m=9.0, echo_rad=ECHO_RAD):
    return cast_rays_on_surfaces(surfaces, GEOMETRY, sensor, np.array(angles_rad), range_max_m, circles, echo_rad)


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


def test_pane_across_y_has_its_normal_along_y():
    surfaces = np.zeros(GEOMETRY.shape, np.uint8)
    surfaces[GEOMETRY.cell_of(0.0, 0.01)[0], :] = SOLID | GLASS_Y
    surfaces[-1, :] = SOLID
    up_rad = math.pi / 2
    assert cast(surfaces, up_rad, up_rad + 0.3) == pytest.approx([0.55, 1.45 / math.cos(0.3)])


def test_behind_a_pane_robots_are_seen_and_in_front_of_it_too():
    surfaces = floor(1.0, SOLID | GLASS_X)
    angle_rad = 0.4
    for center_m in (0.5, 2.0):
        center = (SENSOR.x_m + center_m * math.cos(angle_rad), SENSOR.y_m + center_m * math.sin(angle_rad), 0.2)
        assert cast(surfaces, angle_rad, circles=np.array([center])) == pytest.approx([center_m - 0.2])


def test_through_a_pane_at_the_edge_of_the_grid_nothing_is_seen():
    surfaces = floor(2.9, SOLID | GLASS_X)
    ranges_m = cast(surfaces, 0.0, 0.3)
    assert ranges_m.tolist() == [pytest.approx(2.85), 9.0]


def test_wall_behind_a_pane_is_seen_where_it_begins():
    surfaces = floor(1.0, SOLID | GLASS_X, 2)
    surfaces[:, GEOMETRY.cell_of(1.21, 0.0)[1]] = SOLID
    assert cast(surfaces, 0.3) == pytest.approx([1.15 / math.cos(0.3)])


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


def test_in_a_mirror_a_robot_sees_others_and_itself():
    surfaces = floor(1.0, SOLID | MIRROR_WEST)
    own = (SENSOR.x_m, SENSOR.y_m, 0.2)
    assert cast(surfaces, 0.0, circles=np.array([own])) == pytest.approx([2 * 0.95 - 0.2])
    other = (SENSOR.x_m, SENSOR.y_m + 0.8, 0.2)
    angle_rad = math.atan2(0.8, 2 * 0.95)
    assert cast(surfaces, angle_rad, circles=np.array([other])) == pytest.approx([math.hypot(0.8, 1.9) - 0.2])
    near = (SENSOR.x_m + 0.5, SENSOR.y_m, 0.2)
    assert cast(surfaces, 0.0, circles=np.array([own, near])) == pytest.approx([0.3])


def test_circle_behind_a_mirror_is_not_seen():
    surfaces = floor(1.0, SOLID | MIRROR_WEST)
    behind = (SENSOR.x_m + 2.0, SENSOR.y_m, 0.2)
    assert cast(surfaces, 0.0, circles=np.array([behind])) == pytest.approx([0.95 + 2.0])


def test_back_of_a_mirror_is_a_wall():
    assert cast(floor(1.0, SOLID | MIRROR_EAST), 0.0) == pytest.approx([0.95])


def test_way_over_a_mirror_that_is_too_long_is_no_return():
    surfaces = floor(1.0, SOLID | MIRROR_WEST)
    assert cast(surfaces, 0.0, range_max_m=1.5).tolist() == [1.5]


@pytest.mark.parametrize("sensor", [Pose2D(1.05, 0.0, 0.0), Pose2D(50.0, 0.0, 0.0)])
def test_sensor_within_a_wall_or_off_the_grid_measures_nothing(sensor):
    assert cast(floor(1.0), 0.0, 1.0, sensor=sensor).tolist() == [0.0, 0.0]
