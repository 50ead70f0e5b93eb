"""Camera: takes a picture when somebody asks for one; where it comes from is the manifest's `interface`."""

import struct

import msgspec

from robrain.agent.plugin import Device, external
from robrain.plugins.device.camera.backends import Backend, open_backend
from robrain.plugins.device.camera.interface import CameraInterface, Picture
from robrain.protocol.model.ranges import check_positive
from robrain.protocol.wire.errors import CallError, ErrorCode

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

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """`interface` is one of `zenoh` (the simulator), `file` and `v4l`; what `channel` means depends on it."""

        interface: str = "zenoh"
        channel: str = ""
        """file: a PNG, or a folder of them, in order of their names; v4l: the number of the video device."""
        timeout_s: float = 1.0
        view_rad: float = 1.2
        """Horizontal angle of view; chosen for the simulator, set that of your camera."""

        def __post_init__(self) -> None:
            check_positive(self, "timeout_s")
            if not 0 < self.view_rad < 3.1:
                raise ValueError(f"expected view_rad above 0 and below 3.1, got {self.view_rad}")

    interface = CameraInterface
    parameters: Parameters

    def init(self) -> None:
        self._backend: Backend | None = None

    def activate(self) -> None:
        wanted = self.parameters
        self._backend = open_backend(self.env, wanted.interface, wanted.channel, wanted.timeout_s)

    def deactivate(self) -> None:
        if self._backend is not None:
            self._backend.close()
            self._backend = None

    def snapshot(self) -> Picture:
        """Take a picture."""
        if self._backend is None:
            raise CallError(ErrorCode.INACTIVE, f"{self.env.plugin}: the camera is not open")
        png = self._backend.take()
        width, height = png_size(png)
        return Picture(png=png, width=width, height=height, stamp_ns=self.env.clock.now_ns())

    @external
    def look(self) -> PictureInfo:
        """Take a picture and return its size, to test the camera."""
        picture = self.snapshot()
        return PictureInfo(picture.width, picture.height, len(picture.png), picture.stamp_ns)


def png_size(png: bytes) -> tuple[int, int]:
    """Width and height of a PNG; CallError if it is none, or too large to be passed on."""
    if len(png) > PICTURE_BYTES_MAX:
        raise CallError(ErrorCode.FAILED, f"expected a picture of at most {PICTURE_BYTES_MAX} bytes, got {len(png)}")
    if len(png) < PNG_HEAD.size:
        raise CallError(ErrorCode.FAILED, f"expected a PNG, got {len(png)} bytes")
    signature, chunk, width, height = PNG_HEAD.unpack_from(png)
    if signature != PNG_SIGNATURE or chunk != b"IHDR" or not (width and height):
        raise CallError(ErrorCode.FAILED, f"expected a PNG, got bytes that begin with {png[:8].hex()}")
    return width, height
