import io
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from robrain.agent.authoring.testing import PluginBench
from robrain.plugins.behavior.monitor import changed_share
from robrain.plugins.device.camera import png_size
from robrain.protocol.errors import CallError
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


def test_a_picture_of_another_size_is_all_changed():
    assert changed_share(np.zeros((60, 80, 3)), np.zeros((30, 40, 3))) == 1.0
