"""Where pictures come from. A backend is a class with `take` and `close`; `BACKENDS` names those that there are."""

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from robrain.agent.environment import Environment
from robrain.agent.errors import HardwareAbsent
from robrain.protocol.wire.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.wire.topics import ARENA_CAMERA


class Backend(Protocol):
    """An open camera."""

    def take(self) -> bytes:
        """One picture as a PNG; CallError if there is none."""

    def close(self) -> None:
        """Let go of it."""


class WireCamera:
    """The simulator's: asks the arena, which draws the picture then."""

    def __init__(self, env: Environment, channel: str, timeout_s: float) -> None:
        self._env = env
        self._timeout_s = timeout_s

    def take(self) -> bytes:
        """What the arena draws for this robot."""
        try:
            return self._env.wire.ask(ARENA_CAMERA, robot=self._env.robot, timeout_s=self._timeout_s)
        except NobodyThere as error:
            raise CallError(ErrorCode.FAILED, f"no camera answers: {error}") from error

    def close(self) -> None:
        """Nothing is held."""


class FileCamera:
    """Pictures from the disk, one after the other and then from the beginning: for tests, and to play back."""

    def __init__(self, env: Environment, channel: str, timeout_s: float) -> None:
        path = Path(channel)
        self._paths = sorted(path.glob("*.png")) if path.is_dir() else [path]
        if not channel or not self._paths or not self._paths[0].is_file():
            raise HardwareAbsent(env.plugin, f"expected channel to be a PNG or a folder with some, got {channel!r}")
        self._taken = 0

    def take(self) -> bytes:
        """The next picture."""
        path = self._paths[self._taken % len(self._paths)]
        self._taken += 1
        try:
            return path.read_bytes()
        except OSError as error:
            raise CallError(ErrorCode.FAILED, f"{path} cannot be read: {error}") from error

    def close(self) -> None:
        """Nothing is held."""


class VideoCamera:
    """A video device by OpenCV, which is not installed with robrain: `pip install opencv-python-headless`."""

    def __init__(self, env: Environment, channel: str, timeout_s: float) -> None:
        try:
            self._cv2: Any = importlib.import_module("cv2")
        except ImportError as error:
            why = "interface v4l needs OpenCV: pip install opencv-python-headless"
            raise HardwareAbsent(env.plugin, why) from error
        number = channel or "0"
        if not number.isdecimal():
            raise HardwareAbsent(env.plugin, f"expected channel to be the number of a video device, got {channel!r}")
        self._device = self._cv2.VideoCapture(int(number))
        if not self._device.isOpened():
            raise HardwareAbsent(env.plugin, f"no video device {number}")

    def take(self) -> bytes:
        """What the device sees now."""
        there, pixels = self._device.read()
        if not there:
            raise CallError(ErrorCode.FAILED, "the video device gives no picture")
        encoded, png = self._cv2.imencode(".png", pixels)
        if not encoded:
            raise CallError(ErrorCode.FAILED, "a picture of the video device cannot be encoded")
        return bytes(png.tobytes())

    def close(self) -> None:
        """Let the device go."""
        self._device.release()


BACKENDS: dict[str, Callable[[Environment, str, float], Backend]] = {
    "zenoh": WireCamera,
    "file": FileCamera,
    "v4l": VideoCamera,
}


def open_backend(env: Environment, interface: str, channel: str, timeout_s: float) -> Backend:
    """Open a camera.

    Raises:
        HardwareAbsent: there is none; the text says why.

    """
    if interface not in BACKENDS:
        raise HardwareAbsent(env.plugin, f"expected interface to be one of {', '.join(BACKENDS)}, got {interface!r}")
    return BACKENDS[interface](env, channel, timeout_s)
