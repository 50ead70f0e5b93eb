"""Camera: takes a picture on request; the manifest's `interface` selects the source."""

import importlib
import itertools
import struct
from pathlib import Path
from typing import Annotated, Any, Protocol

import msgspec
from msgspec import Meta

from robrain.agent.environment import Environment
from robrain.agent.errors import HardwareAbsent
from robrain.agent.plugin import Device, external
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.messages.team.arena_messages import ARENA_CAMERA
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import Positive


class Picture(msgspec.Struct, frozen=True, kw_only=True):
    """An image of a camera.

    It has no place; the requester knows the place.
    """

    png: bytes
    width: int
    height: int
    """Pixels."""
    stamp_ns: int
    """When it was taken, by the run's clock."""


class CameraInterface(Protocol):
    """Pictures on request."""

    def snapshot(self) -> Picture:
        """Take a picture.

        Raises:
            CallError: the camera provides no picture; the text is the reason.

        """


class Backend:
    """An open camera.

    Args:
        env: the plugin's environment.
        parameters: the plugin's parameters.

    Raises:
        HardwareAbsent: there is no camera; the text is the reason.

    """

    def __init__(self, env: Environment, parameters: "CameraDevice.Parameters") -> None:
        self._env, self._parameters = env, parameters

    def capture(self) -> bytes:
        """One picture as a PNG; CallError if there is none."""
        raise NotImplementedError

    def close(self) -> None:
        """Release the camera."""


class WireCamera(Backend):
    """The simulator's camera: requests each picture from the arena, which draws it."""

    def capture(self) -> bytes:
        """The image that the arena draws for this robot."""
        try:
            return self._env.wire.ask(ARENA_CAMERA, robot=self._env.robot, timeout_s=self._parameters.timeout_s)
        except NobodyThere as error:
            raise CallError(ErrorCode.FAILED, f"no camera answers: {error}") from error


class FileCamera(Backend):
    """Pictures from the disk in a loop: for tests and playback."""

    def __init__(self, env: Environment, parameters: "CameraDevice.Parameters") -> None:
        channel = parameters.channel
        path = Path(channel)
        paths = sorted(path.glob("*.png")) if path.is_dir() else [path]
        if not channel or not paths or not paths[0].is_file():
            raise HardwareAbsent(env.plugin, f"expected channel to be a PNG or a folder with some, got {channel!r}")
        self._paths = itertools.cycle(paths)

    def capture(self) -> bytes:
        """The next picture."""
        path = next(self._paths)
        try:
            return path.read_bytes()
        except OSError as error:
            raise CallError(ErrorCode.FAILED, f"{path} cannot be read: {error}") from error


class VideoCamera(Backend):
    """A video device by OpenCV, which is not installed with robrain: `pip install opencv-python-headless`."""

    def __init__(self, env: Environment, parameters: "CameraDevice.Parameters") -> None:
        try:
            self._cv2: Any = importlib.import_module("cv2")
        except ImportError as error:
            reason = "interface v4l needs OpenCV: pip install opencv-python-headless"
            raise HardwareAbsent(env.plugin, reason) from error
        number = parameters.channel or "0"
        if not number.isdecimal():
            raise HardwareAbsent(env.plugin, f"expected channel to be the number of a video device, got {number!r}")
        self._device = self._cv2.VideoCapture(int(number))
        if not self._device.isOpened():
            raise HardwareAbsent(env.plugin, f"no video device {number}")

    def capture(self) -> bytes:
        """The present image of the device."""
        there, pixels = self._device.read()
        if not there:
            raise CallError(ErrorCode.FAILED, "the video device gives no picture")
        encoded, png = self._cv2.imencode(".png", pixels)
        if not encoded:
            raise CallError(ErrorCode.FAILED, "a picture of the video device cannot be encoded")
        return bytes(png.tobytes())

    def close(self) -> None:
        """Release the device."""
        self._device.release()


BACKENDS: dict[str, type[Backend]] = {"zenoh": WireCamera, "file": FileCamera, "v4l": VideoCamera}


PNG_HEAD = struct.Struct(">8s4x4sII")
"""Signature, length and name of the first chunk, width and height (PNG specification, sections 5.2 and 11.2.2)."""
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
PICTURE_BYTES_MAX = 4 << 20


class PictureInfo(msgspec.Struct, frozen=True):
    """A picture without its pixels."""

    width: int
    height: int
    bytes: int
    stamp_ns: int


class CameraDevice(Device):
    """One camera, level, looking ahead. It works only on request."""

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """`interface` is one of `zenoh` (the simulator), `file` and `v4l`; what `channel` means depends on it."""

        interface: str = "zenoh"
        channel: str = ""
        """file: a PNG, or a folder of them, in order of their names; v4l: the number of the video device."""
        timeout_s: Positive = 1.0
        view_rad: Annotated[float, Meta(gt=0, lt=3.1)] = 1.2
        """Horizontal angle of view; chosen for the simulator, set that of your camera."""

    interface = CameraInterface
    parameters: Parameters

    def init(self) -> None:
        self._backend: Backend | None = None

    def activate(self) -> None:
        name = self.parameters.interface
        if name not in BACKENDS:
            known = ", ".join(BACKENDS)
            raise HardwareAbsent(self.env.plugin, f"expected interface to be one of {known}, got {name!r}")
        self._backend = BACKENDS[name](self.env, self.parameters)

    def deactivate(self) -> None:
        if self._backend is not None:
            self._backend.close()
            self._backend = None

    def snapshot(self) -> Picture:
        """Take a picture."""
        if self._backend is None:
            raise CallError(ErrorCode.INACTIVE, f"{self.env.plugin}: the camera is not open")
        png = self._backend.capture()
        width, height = png_size(png)
        return Picture(png=png, width=width, height=height, stamp_ns=self.env.clock.now_ns())

    @external
    def test_picture(self) -> PictureInfo:
        """Take a picture and return its size, to test the camera."""
        picture = self.snapshot()
        return PictureInfo(picture.width, picture.height, len(picture.png), picture.stamp_ns)


def png_size(png: bytes) -> tuple[int, int]:
    """Width and height of a PNG; CallError if it is invalid or too large."""
    if len(png) > PICTURE_BYTES_MAX:
        raise CallError(ErrorCode.FAILED, f"expected a picture of at most {PICTURE_BYTES_MAX} bytes, got {len(png)}")
    if len(png) < PNG_HEAD.size:
        raise CallError(ErrorCode.FAILED, f"expected a PNG, got {len(png)} bytes")
    signature, chunk, width, height = PNG_HEAD.unpack_from(png)
    if signature != PNG_SIGNATURE or chunk != b"IHDR" or not (width and height):
        raise CallError(ErrorCode.FAILED, f"expected a PNG, got bytes that begin with {png[:8].hex()}")
    return width, height
