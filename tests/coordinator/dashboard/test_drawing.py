import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from robrain.coordinator.dashboard.layers.marker_layers import scan_points
from robrain.coordinator.dashboard.layers.track_layers import DASHES, dashes, tapering_line
from robrain.coordinator.dashboard.scene import meshes
from robrain.coordinator.dashboard.scene.camera import (
    OVERVIEW_ELEVATION_RAD,
    TOP_ELEVATION_RAD,
    Bounds,
    stand_to_see,
)
from robrain.coordinator.dashboard.scene.merged_meshes import copies
from robrain.coordinator.dashboard.scene.scene_nodes import plain, to_linear
from robrain.coordinator.dashboard.state.robot_view import RobotView
from robrain.coordinator.dashboard.state.team_view import RateMeter
from robrain.coordinator.drawing.drawn_floor import cover_with_boxes
from robrain.coordinator.drawing.palette import look_of
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.wire.messages.robots.robot_messages import RobotState
from robrain.protocol.wire.messages.team.arena_messages import Scan

FOV_RAD = math.radians(45)


@pytest.mark.parametrize("elevation_rad", [OVERVIEW_ELEVATION_RAD, TOP_ELEVATION_RAD])
@pytest.mark.parametrize("aspect", [0.6, 1.1, 2.5])
@pytest.mark.parametrize("bounds", [(-12.0, -8.0, 12.0, 8.0), (100.0, 0.0, 103.0, 60.0), (0.0, 0.0, 50.0, 2.0)])
def test_all_of_the_map_is_in_the_picture_and_fills_it(bounds: Bounds, aspect: float, elevation_rad: float) -> None:
    stand = stand_to_see(bounds, elevation_rad, aspect, FOV_RAD)
    eye, look_at = np.array(stand.position), np.array(stand.look_at)
    forward = (look_at - eye) / np.linalg.norm(look_at - eye)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    x_min, y_min, x_max, y_max = bounds
    corners = np.array([(x, y, 0.0) for x in (x_min, x_max) for y in (y_min, y_max)]) - eye
    across = corners @ right / (corners @ forward) / math.tan(FOV_RAD / 2) / aspect
    along = corners @ up / (corners @ forward) / math.tan(FOV_RAD / 2)
    reach = max(np.abs(across).max(), np.abs(along).max())
    assert 0.9 < reach < 0.95
    assert look_at[2] == pytest.approx(0.0, abs=1e-9)


@given(arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=12)))
def test_boxes_cover_the_occupied_cells_and_no_others(mask: np.ndarray) -> None:
    covered = np.zeros(mask.shape, np.int64)
    for row, column, rows, columns in cover_with_boxes(mask):
        covered[row : row + rows, column : column + columns] += 1
    assert (covered == mask).all()


def test_straight_wall_is_one_box() -> None:
    mask = np.zeros((50, 60), np.bool_)
    mask[3:5, 2:58] = True
    assert cover_with_boxes(mask).tolist() == [[3, 2, 2, 56]]


@pytest.mark.parametrize(
    "mesh",
    [
        meshes.robot_body(),
        meshes.robot_nose(),
        meshes.robot_dart(),
        meshes.tent(1, 1),
        meshes.flag(),
        meshes.bolt(),
        meshes.cube(),
        meshes.pin(0.1, 0.5),
        meshes.diamond(0.1, 0.3),
    ],
)
def test_meshes_are_well_formed_and_stand_on_the_floor(mesh: meshes.Mesh) -> None:
    assert mesh.faces.max() < len(mesh.vertices)
    assert mesh.vertices[:, 2].min() >= 0.0
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert areas.min() > 0.0


def test_nose_points_along_x() -> None:
    assert meshes.robot_nose().vertices[:, 0].argmax() == np.abs(meshes.robot_nose().vertices).max(axis=1).argmax()


def test_trail_is_thinned_reaches_the_robot_and_is_widest_there() -> None:
    trail = [Point2D(float(x), 0.0) for x in range(101)]
    mesh = tapering_line(trail, 30, 0.5)
    strips = mesh.vertices.reshape(-1, 4, 3)
    assert len(strips) <= 30
    assert strips[-1, 1, 0] == 100.0
    assert (strips[1:, 0, 0] == strips[:-1, 1, 0]).all()
    widths_m = strips[:, 3, 1] - strips[:, 0, 1]
    assert widths_m[-1] == pytest.approx(0.5)
    assert (np.diff(widths_m) > 0).all()


def test_copies_of_a_mesh_are_turned_scaled_and_placed() -> None:
    here = np.array([[1.0, 2.0, 0.0], [5.0, 5.0, 1.0]], np.float32)
    sizes = np.array([[1.0, 1.0, 1.0], [2.0, 4.0, 3.0]], np.float32)
    mesh = copies(meshes.cube(), here, sizes, np.array([0.0, math.pi / 2], np.float32))
    one = len(meshes.cube().vertices)
    np.testing.assert_allclose(mesh.vertices[:one], meshes.cube().vertices + here[0], atol=1e-6)
    np.testing.assert_allclose(mesh.vertices[one:].min(axis=0), [3.0, 4.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(mesh.vertices[one:].max(axis=0), [7.0, 6.0, 4.0], atol=1e-6)
    assert mesh.faces.max() == len(mesh.vertices) - 1


def test_dashes_lie_on_the_path_and_leave_gaps() -> None:
    drawn = dashes([Point2D(0.0, 0.0), Point2D(1.0, 0.0), Point2D(1.0, 1.0)])
    lengths_m = np.abs(drawn[:, 1] - drawn[:, 0]).sum(axis=1)
    assert 0.9 < lengths_m.sum() < 1.3
    assert (np.isclose(drawn[:, :, 1], 0.0) | np.isclose(drawn[:, :, 0], 1.0)).all()
    assert len(dashes([Point2D(-1e6, 0.0), Point2D(1e6, 0.0)])) == DASHES
    assert dashes([Point2D(0.0, 0.0)]).shape == (0, 2, 3)
    assert dashes([Point2D(0.0, 0.0), Point2D(0.0, 0.0)]).shape == (0, 2, 3)


def test_scan_is_drawn_where_its_beams_ended() -> None:
    robot = RobotView("r1", 0, state=RobotState(robot="r1", pose=Pose2D(1.0, 2.0, math.pi / 2)))
    assert scan_points(robot).shape == (0, 3)
    robot.scan = Scan(
        robot="r1", angle_min_rad=0.0, angle_increment_rad=math.pi / 2, range_max_m=4.0, ranges_mm=[1000, 0, 2000]
    )
    np.testing.assert_allclose(scan_points(robot)[:, :2], [[1.0, 3.0], [1.0, 0.0]], atol=1e-6)


def test_first_forty_robots_look_different() -> None:
    assert len({look_of(index) for index in range(40)}) == 40


def test_label_is_short_and_ascii() -> None:
    assert plain("é" * 100) == "?" * 40


def test_linear_light_keeps_black_and_white() -> None:
    assert to_linear(np.array([[0, 255, 188]], np.uint8)).tolist() == [[0, 255, 128]]


@given(st.floats(0.1, 100.0), st.floats(1.0, 10.0))
def test_steady_growth_is_measured_exactly(per_s: float, window_s: float) -> None:
    meter = RateMeter(window_s)
    for tick in range(100):
        meter.add(tick * 0.2, per_s * tick * 0.2)
    assert meter.per_s == pytest.approx(per_s)


def test_rate_is_of_the_last_seconds_and_unknown_after_a_fresh_start() -> None:
    meter = RateMeter(2.0)
    for second in range(20):
        meter.add(float(second), 10.0 * second if second < 10 else 90.0)
    assert meter.per_s == 0.0
    meter.add(20.0, 5.0)
    assert meter.per_s is None
    with pytest.raises(ValueError, match="window_s"):
        RateMeter(0.0)
