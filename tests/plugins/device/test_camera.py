import io
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from robrain.agent.authoring.testing import PluginBench
from robrain.plugins.behavior.monitor import changed_share, colors_of
from robrain.plugins.device.camera import png_size
from robrain.protocol.errors import CallError
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.sim.robot.camera import Camera, CameraSpec, SeenRobot
from tests.plugins.behavior.errands import Errands


def png(width=4, height=3, color=(1, 2, 3)):
    buffer = io.BytesIO()
    Image.new("RGB", (width, height), color).save(buffer, format="PNG")
    return buffer.getvalue()


def test_a_simulated_camera_sees_what_the_arena_draws():
    run = Errands("camera")
    run.run(0.1)
    info = run.call("camera", "test_picture")
    assert (info["width"], info["height"], info["stamp_ns"]) == (160, 120, run.clock.now_ns())
    picture = run.plugin("camera").snapshot()
    assert picture.png == run.arena.picture("r1")
    run.close()


def test_a_camera_that_nobody_answers_for_says_so():
    with PluginBench(load=["camera"]) as bench:
        with pytest.raises(CallError, match="no camera answers"):
            bench.call("camera", "test_picture")
        assert bench.info("camera").state == "active"  # the next picture may come


def test_pictures_of_a_folder_come_in_order_and_from_the_beginning(tmp_path):
    for number, width in enumerate((5, 6)):
        (tmp_path / f"{number}.png").write_bytes(png(width))
    parameters = {"camera": {"interface": "file", "channel": str(tmp_path)}}
    with PluginBench(load=["camera"], parameters=parameters) as bench:
        assert [bench.call("camera", "test_picture")["width"] for _ in range(3)] == [5, 6, 5]


@pytest.mark.parametrize(
    ("parameters", "why"),
    [
        ({"interface": "telepathy"}, "expected interface to be one of zenoh, file, v4l, got 'telepathy'"),
        ({"interface": "file"}, "a PNG or a folder with some, got ''"),
        ({"interface": "file", "channel": "/no/such/folder"}, "a PNG or a folder with some"),
        ({"interface": "v4l", "channel": "7"}, "OpenCV|no video device 7"),
        ({"timeout_s": 0.0}, "timeout_s > 0"),
        ({"view_rad": 4.0}, "view_rad < 3.1"),
    ],
)
def test_a_camera_that_is_not_there_is_left_out_with_the_reason(parameters, why):
    with PluginBench(load=["camera"], parameters={"camera": parameters}) as bench:
        info = bench.info("camera")
    assert info.state == "faulted"
    assert re.search(why, info.why), info.why


@pytest.mark.parametrize("broken", [b"", b"no picture", png()[:20], b"GIF89a" + bytes(40)])
def test_what_is_no_png_is_not_taken_for_a_picture(broken):
    with pytest.raises(CallError, match="expected a PNG"):
        png_size(broken)


def test_a_picture_that_is_too_large_is_refused():
    with pytest.raises(CallError, match="at most 4194304 bytes"):
        png_size(png() + bytes(5 << 20))


class Webcam:
    """A video device and the part of OpenCV that finds it."""

    def __init__(self, *, number=0, is_there=True, sees=True, encodes=True):
        self._number, self._is_there, self._sees, self._encodes = number, is_there, sees, encodes
        self.is_released = False

    def VideoCapture(self, number):  # noqa: N802 - OpenCV's name
        assert number == self._number
        return self

    def isOpened(self):  # noqa: N802 - OpenCV's name
        return self._is_there

    def read(self):
        return self._sees, "pixels"

    def imencode(self, ending, pixels):
        assert (ending, pixels) == (".png", "pixels")
        return self._encodes, SimpleNamespace(tobytes=lambda: png(9, 8))

    def release(self):
        self.is_released = True


def with_webcam(monkeypatch, webcam, channel=""):
    monkeypatch.setitem(sys.modules, "cv2", webcam)
    return PluginBench(load=["camera"], parameters={"camera": {"interface": "v4l", "channel": channel}})


@pytest.mark.parametrize(("channel", "number"), [("", 0), ("2", 2)])
def test_picture_of_a_video_device_is_a_png_and_the_device_is_let_go(monkeypatch, channel, number):
    webcam = Webcam(number=number)
    with with_webcam(monkeypatch, webcam, channel) as bench:
        info = bench.call("camera", "test_picture")
        assert (info["width"], info["height"]) == (9, 8)
        assert not webcam.is_released
    assert webcam.is_released


@pytest.mark.parametrize(
    ("fault", "why"),
    [({"sees": False}, "the video device gives no picture"), ({"encodes": False}, "cannot be encoded")],
)
def test_video_device_without_a_picture_says_why(monkeypatch, fault, why):
    with with_webcam(monkeypatch, Webcam(**fault)) as bench:
        with pytest.raises(CallError, match=why):
            bench.call("camera", "test_picture")
        assert bench.info("camera").state == "active"


@pytest.mark.parametrize(
    ("webcam", "channel", "why"),
    [
        (Webcam(is_there=False), "", "no video device 0"),
        (Webcam(), "front", "expected channel to be the number of a video device, got 'front'"),
        (None, "", "interface v4l needs OpenCV"),
    ],
)
def test_video_device_that_cannot_be_opened_is_left_out_with_the_reason(monkeypatch, webcam, channel, why):
    with with_webcam(monkeypatch, webcam, channel) as bench:
        info = bench.info("camera")
    assert info.state == "faulted"
    assert why in info.why


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
