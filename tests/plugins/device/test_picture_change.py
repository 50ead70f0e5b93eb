import io

import numpy as np
import pytest
from PIL import Image

from robrain.plugins.behavior.monitor import changed_share, colors_of
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.sim.robot.camera import Camera, CameraSpec, SeenRobot

HERE = Pose2D(1.0, 2.0, 0.3)
CHANGED = 0.002


def look(pose=HERE, robots=(), moment=0, noise_levels=2.0):
    occupied = np.ones((80, 120), np.bool_)
    occupied[2:-2, 2:-2] = False
    occupied[20:26, 70:76] = True
    camera = Camera(CameraSpec(noise_levels=noise_levels), occupied, GridGeometry(0.05, 0.0, 0.0, 120, 80), seed=3)
    return colors_of(camera.png(pose, robots, [], moment))


@pytest.mark.parametrize("moment", [1, 2, 3])
def test_the_noise_of_the_camera_is_no_change(moment):
    assert changed_share(look(), look(moment=moment, noise_levels=4.0)) < CHANGED


@pytest.mark.parametrize("turn_rad", [-0.08, -0.03, 0.01, 0.05])
def test_a_robot_that_does_not_face_quite_as_it_did_sees_no_change(turn_rad):
    turned = Pose2D(HERE.x_m, HERE.y_m, HERE.yaw_rad + turn_rad)
    assert changed_share(look(), look(turned, moment=1)) < CHANGED


@pytest.mark.parametrize(("dx_m", "dy_m"), [(0.02, 0.0), (0.0, 0.02), (-0.02, 0.02)])
def test_a_robot_that_stands_a_little_aside_sees_no_change(dx_m, dy_m):
    aside = Pose2D(HERE.x_m + dx_m, HERE.y_m + dy_m, HERE.yaw_rad)
    assert changed_share(look(), look(aside, moment=1)) < CHANGED


@pytest.mark.parametrize("turn_rad", [-0.065, 0.004, 0.007, 0.065])
def test_a_turn_by_a_part_of_a_pixel_or_many_is_undone(turn_rad):
    turned = Pose2D(HERE.x_m, HERE.y_m, HERE.yaw_rad + turn_rad)
    assert changed_share(look(noise_levels=0.0), look(turned, noise_levels=0.0)) == 0.0


@pytest.mark.parametrize("turn_rad", [-0.06, 0.0, 0.05])
def test_a_robot_some_4_m_away_is_told_by_one_that_has_turned_meanwhile(turn_rad):
    come = SeenRobot(1, Pose2D(4.6, 2.0 + 0.31 * 3.6, 0.0), 0.2)
    turned = Pose2D(HERE.x_m, HERE.y_m, HERE.yaw_rad + turn_rad)
    assert changed_share(look(), look(turned, robots=[come], moment=1)) >= CHANGED


@pytest.mark.parametrize("x_m", [2.0, 3.0, 4.0])
def test_a_robot_that_has_come_is_a_change_and_the_nearer_the_larger(x_m):
    come = SeenRobot(1, Pose2D(x_m, 2.0 + 0.31 * (x_m - 1.0), 0.0), 0.2)
    assert changed_share(look(), look(robots=[come], moment=1)) >= CHANGED


def test_a_picture_of_another_size_is_all_changed():
    assert changed_share(np.zeros((60, 80, 3)), np.zeros((30, 40, 3))) == 1.0


def test_a_pixel_has_the_colour_of_four_on_average():
    buffer = io.BytesIO()
    pixels = np.zeros((5, 4, 3), np.uint8)
    pixels[0, 0, 0] = pixels[1, 1, 0] = 200
    Image.fromarray(pixels).save(buffer, format="PNG")
    colors = colors_of(buffer.getvalue())
    assert colors.shape == (2, 2, 3)
    assert colors[:, :, 0].tolist() == [[100.0, 0.0], [0.0, 0.0]]
    assert not colors[:, :, 1:].any()


def test_what_is_no_picture_is_not_compared():
    with pytest.raises(OSError, match="cannot identify"):
        colors_of(b"no picture at all")
