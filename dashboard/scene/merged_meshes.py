"""Many solids of few colours as one mesh for each colour.

In every frame, a software renderer needs 30 µs for each instance of a batched mesh and for each of viser's own lines.
Triangles of one mesh cost next to nothing. With a hundred robots that is the difference between 2 and 30 frames a
second. Objects that move all the time are batched nevertheless (`Instances`), as a merged mesh has to be sent again as
a whole.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
import viser

from robrain.dashboard.scene.meshes import Mesh, join
from robrain.dashboard.scene.scene_nodes import Rows
from robrain.recording.drawing.palette import Rgb

WIDE_M = 24.0
"""Up to this size of the map, strips have the width that they are given."""


class MergedMeshes:
    """One node for each colour, replaced when its mesh changes."""

    def __init__(self, scene: viser.SceneApi, name: str, opacity: float | None = None) -> None:
        self._scene = scene
        self._name = name
        self._opacity = opacity
        self._shown: dict[Rgb, _Shown] = {}
        self._made = 0

    def show(self, meshes: Mapping[Rgb, Mesh]) -> None:
        """Show these meshes and no others; a mesh without faces is left out."""
        wanted = {color: mesh for color, mesh in meshes.items() if len(mesh.faces)}
        for color in [color for color in self._shown if color not in wanted]:
            self._shown.pop(color).handle.remove()
        for color, mesh in wanted.items():
            known = self._shown.get(color)
            if known is None:
                self._made += 1
            elif _is_same(known.mesh, mesh):
                continue
            number = self._made if known is None else known.number
            self._shown[color] = _Shown(number, self._add(number, color, mesh), mesh)

    def _add(self, number: int, color: Rgb, mesh: Mesh) -> viser.MeshHandle:
        return self._scene.add_mesh_simple(
            f"{self._name}/{number}",
            mesh.vertices,
            mesh.faces,
            color=color,
            opacity=self._opacity,
            flat_shading=True,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )


class _Shown(NamedTuple):
    number: int
    handle: viser.MeshHandle
    mesh: Mesh


def by_color(pieces: Iterable[tuple[Rgb, Mesh]]) -> dict[Rgb, Mesh]:
    """Pieces of one colour as one mesh."""
    found: dict[Rgb, list[Mesh]] = {}
    for color, mesh in pieces:
        found.setdefault(color, []).append(mesh)
    return {color: join(*meshes) for color, meshes in found.items()}


def copies(mesh: Mesh, positions: Rows, scales: Rows | None = None, yaw_rad: Rows | None = None) -> Mesh:
    """A mesh at positions (N, 3), metres, with scales (N, 3) and headings (N,), as one."""
    count, size = len(positions), len(mesh.vertices)
    scales = np.ones((count, 3), np.float32) if scales is None else scales
    turns = np.zeros(count, np.float32) if yaw_rad is None else yaw_rad
    cos, sin = np.cos(turns)[:, None], np.sin(turns)[:, None]
    scaled = mesh.vertices[None, :, :] * scales[:, None, :]
    vertices = np.empty((count, size, 3), np.float32)
    vertices[:, :, 0] = cos * scaled[:, :, 0] - sin * scaled[:, :, 1]
    vertices[:, :, 1] = sin * scaled[:, :, 0] + cos * scaled[:, :, 1]
    vertices[:, :, 2] = scaled[:, :, 2]
    vertices += positions[:, None, :]
    faces = mesh.faces[None, :, :] + (size * np.arange(count, dtype=np.uint32))[:, None, None]
    return Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3).astype(np.uint32))


def strips(lines: Rows, width_m: float | Rows) -> Mesh:
    """Lines between points (N, 2, 3), metres, as flat strips of one width, or of a width (N,) each."""
    along = lines[:, 1, :2] - lines[:, 0, :2]
    length = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)
    half = 0.5 * np.broadcast_to(np.asarray(width_m, np.float32), length.shape)
    across = np.zeros((len(lines), 3), np.float32)
    across[:, 0], across[:, 1] = -along[:, 1] / length * half, along[:, 0] / length * half
    corners = np.stack([lines[:, 0] - across, lines[:, 1] - across, lines[:, 1] + across, lines[:, 0] + across], axis=1)
    first = 4 * np.arange(len(lines), dtype=np.uint32)[:, None]
    faces = np.concatenate([first + np.array([[0, 1, 2]], np.uint32), first + np.array([[0, 2, 3]], np.uint32)])
    return Mesh(corners.reshape(-1, 3).astype(np.float32), faces.astype(np.uint32))


def widen_for(size_m: float) -> float:
    """Factor of the width of strips on a map of this size, so that they are visible in the overview."""
    return max(1.0, size_m / WIDE_M)


def _is_same(one: Mesh, other: Mesh) -> bool:
    return np.array_equal(one.vertices, other.vertices) and np.array_equal(one.faces, other.faces)
