"""Scene nodes with many parts: one message moves all of them, and their number may change.

A node is replaced, under its old name, when the number of its parts changes. Its arrays must never disagree in length,
even between two messages. Otherwise only the arrays that differ are sent.

Colours are given in sRGB, as everywhere on a page.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import viser
from numpy.typing import NDArray

from robrain.dashboard.scene.camera import Bounds
from robrain.dashboard.scene.meshes import Mesh
from robrain.protocol.model.geometry import Point2D

Rows = NDArray[np.float32]
Colors = NDArray[np.uint8]


def to_linear(colors: Colors) -> Colors:
    """Linear light of sRGB colours (IEC 61966-2-1), which viser passes to three.js unconverted, unless in a picture."""
    srgb = colors / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    encoded: Colors = np.rint(255 * linear).astype(np.uint8)
    return encoded


class Instances:
    """One mesh at many places."""

    def __init__(self, scene: viser.SceneApi, name: str, mesh: Mesh) -> None:
        self._scene = scene
        self._name = name
        self._mesh = mesh
        self._handle: viser.BatchedMeshHandle | None = None

    def show(self, positions: Rows, scales: Rows, colors: Colors, yaw_rad: Rows | None = None) -> None:
        """Show the mesh at positions (N, 3), metres, with scales (N, 3), colours (N, 3) and headings (N,)."""
        count = len(positions)
        if count == 0:
            if self._handle is not None:
                self._handle.remove()
                self._handle = None
            return
        linear = to_linear(colors)
        wxyzs = _headings(np.zeros(count, np.float32) if yaw_rad is None else yaw_rad)
        if self._handle is None or len(self._handle.batched_positions) != count:
            self._handle = self._scene.add_batched_meshes_simple(
                self._name,
                self._mesh.vertices,
                self._mesh.faces,
                wxyzs,
                positions,
                batched_scales=scales,
                batched_colors=linear,
                lod="off",
                flat_shading=True,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
            return
        self._handle.batched_positions = positions
        self._handle.batched_wxyzs = wxyzs
        self._handle.batched_scales = scales
        self._handle.batched_colors = linear


class FloorPicture:
    """A picture that lies on the floor."""

    def __init__(self, scene: viser.SceneApi, name: str) -> None:
        self._scene = scene
        self._name = name
        self._handle: viser.ImageHandle | None = None
        self._bounds: Bounds | None = None

    def show(self, picture: NDArray[np.uint8], bounds: Bounds, z_m: float) -> None:
        """Show a picture, row 0 at the lowest y, over these bounds."""
        if self._handle is not None and bounds == self._bounds:
            self._handle.image = picture
            return
        self._bounds = x_min, y_min, x_max, y_max = bounds
        self._handle = self._scene.add_image(
            self._name,
            picture,
            x_max - x_min,
            y_max - y_min,
            format="png",
            cast_shadow=False,
            receive_shadow=False,
            position=((x_min + x_max) / 2, (y_min + y_max) / 2, z_m),
        )

    def hide(self) -> None:
        """Remove the picture."""
        if self._handle is not None:
            self._handle.remove()
            self._handle = None


class Labels:
    """Texts in the scene by key, each above or below its place."""

    def __init__(self, scene: viser.SceneApi, name: str, size: float = 1.0, *, below: bool = False) -> None:
        self._scene = scene
        self._name = name
        self._size = size
        self._below = below
        self._handles: dict[str, viser.LabelHandle] = {}
        self._made = 0

    def show(self, texts: Mapping[str, tuple[str, tuple[float, float, float]]]) -> None:
        """Show these texts at these places, metres, and no others."""
        for key in [key for key in self._handles if key not in texts]:
            self._handles.pop(key).remove()
        for key, (text, position) in texts.items():
            shown = plain(text)
            handle = self._handles.get(key)
            if handle is None:
                # Names come over the wire and a slash would nest nodes: nodes are numbered instead.
                self._made += 1
                self._handles[key] = self._scene.add_label(
                    f"{self._name}/{self._made}",
                    shown,
                    position=position,
                    font_screen_scale=self._size,
                    anchor="top-center" if self._below else "bottom-center",
                )
                continue
            if handle.text != shown:
                handle.text = shown
            if tuple(handle.position) != position:
                handle.position = position


def plain(text: str) -> str:
    """Printable ASCII, at most 40 characters: for any other the browser would fetch fonts from the internet.

    >>> plain("r1 → r2")
    'r1 ? r2'
    """
    return "".join(char if " " <= char <= "~" else "?" for char in text[:40])


def _headings(yaw_rad: Rows) -> Rows:
    """Quaternions (N, 4), w first, of turns about z."""
    half = yaw_rad.astype(np.float64) / 2
    zeros = np.zeros_like(half)
    return np.column_stack([np.cos(half), zeros, zeros, np.sin(half)]).astype(np.float32)


def rows(values: list[tuple[float, float, float]]) -> Rows:
    """A list of triples as float32 (N, 3)."""
    return np.array(values, np.float32).reshape(-1, 3)


def colors(values: list[tuple[int, int, int]]) -> Colors:
    """A list of RGB triples as uint8 (N, 3)."""
    return np.array(values, np.uint8).reshape(-1, 3)


def dashed(path: Sequence[Point2D], dash_m: float, z_m: float, most: int) -> Rows:
    """A path as at most `most` dashes of equal length, float32 (N, 2, 3), metres; unbroken if `dash_m` is 0.

    The rest of a longer path is cut off.
    """
    if len(path) < 2:
        return np.empty((0, 2, 3), np.float32)
    corners = np.array([(point.x_m, point.y_m) for point in path])
    lengths_m = np.hypot(*np.diff(corners, axis=0).T)
    if not dash_m:
        raised = np.column_stack([corners, np.full(len(corners), z_m)]).astype(np.float32)
        return np.stack([raised[:-1], raised[1:]], axis=1)[:most]
    along_m = np.concatenate([[0.0], np.cumsum(lengths_m)])
    starts_m = np.arange(0.0, min(along_m[-1], 2 * dash_m * most), 2 * dash_m)
    ends_m = np.minimum(starts_m + dash_m, along_m[-1])
    both_m = np.stack([starts_m, ends_m], axis=1)
    x_m, y_m = (np.interp(both_m, along_m, corners[:, axis]) for axis in (0, 1))
    return np.stack([x_m, y_m, np.full(x_m.shape, z_m)], axis=2).astype(np.float32)
