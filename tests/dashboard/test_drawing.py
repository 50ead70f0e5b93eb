import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra.numpy import array_shapes, arrays

from robrain.dashboard.layers.marker_layers import scan_points
from robrain.dashboard.scene.camera import OVERVIEW_ELEVATION_RAD, TOP_ELEVATION_RAD, Bounds, viewpoint_of
from robrain.dashboard.state.shown_robot import ShownRobot
from robrain.dashboard.state.shown_team import RateMeter
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.team.arena_messages import Scan
from robrain.protocol.model.geometry import Pose2D
from robrain.recording.drawing.drawn_map import cover_with_boxes

FOV_RAD = math.radians(45)


@pytest.mark.parametrize("elevation_rad", [OVERVIEW_ELEVATION_RAD, TOP_ELEVATION_RAD])
@pytest.mark.parametrize("aspect", [0.6, 1.1, 2.5])
@pytest.mark.parametrize("bounds", [(-12.0, -8.0, 12.0, 8.0), (100.0, 0.0, 103.0, 60.0), (0.0, 0.0, 50.0, 2.0)])
def test_all_of_the_map_is_in_the_picture_and_fills_it(bounds: Bounds, aspect: float, elevation_rad: float) -> None:
    stand = viewpoint_of(bounds, elevation_rad, aspect)
    eye, target = np.array(stand.position), np.array(stand.target)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    x_min, y_min, x_max, y_max = bounds
    corners = np.array([(x, y, 0.0) for x in (x_min, x_max) for y in (y_min, y_max)]) - eye
    across = corners @ right / (corners @ forward) / math.tan(FOV_RAD / 2) / aspect
    along = corners @ up / (corners @ forward) / math.tan(FOV_RAD / 2)
    reach = max(np.abs(across).max(), np.abs(along).max())
    assert 0.9 < reach < 0.95
    assert target[2] == pytest.approx(0.0, abs=1e-9)


@given(arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=12)))
def test_boxes_cover_the_occupied_cells_and_no_others(mask: np.ndarray) -> None:
    covered = np.zeros(mask.shape, np.int64)
    for row, column, rows, columns in cover_with_boxes(mask):
        covered[row : row + rows, column : column + columns] += 1
    assert (covered == mask).all()


def test_scan_is_drawn_where_its_beams_ended() -> None:
    robot = ShownRobot("r1", 0, state=RobotState(robot="r1", pose=Pose2D(1.0, 2.0, math.pi / 2)))
    assert scan_points(robot).shape == (0, 3)
    robot.scan = Scan(
        robot="r1", angle_min_rad=0.0, angle_increment_rad=math.pi / 2, range_max_m=4.0, ranges_mm=[1000, 0, 2000]
    )
    np.testing.assert_allclose(scan_points(robot)[:, :2], [[1.0, 3.0], [1.0, 0.0]], atol=1e-6)


def test_rate_is_of_the_last_seconds_and_unknown_after_a_fresh_start() -> None:
    meter = RateMeter()
    for second in range(20):
        meter.add(float(second), 10.0 * second if second < 10 else 90.0)
    assert meter.per_s == 0.0
    meter.add(20.0, 5.0)
    assert meter.per_s is None
