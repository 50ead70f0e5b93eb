"""Triangles of an object on the floor: vertices float32 (V, 3) in metres, faces uint32 (F, 3)."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Mesh(NamedTuple):
    """A solid in its own frame, z up, standing on z = 0."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]


def prism(outline: NDArray[np.float64], z_min_m: float, z_max_m: float) -> Mesh:
    """A convex outline (N, 2), counter-clockwise, raised from `z_min_m` to `z_max_m`; its floor is left open."""
    lower = np.column_stack([outline, np.full(len(outline), z_min_m)])
    upper = np.column_stack([outline, np.full(len(outline), z_max_m)])
    # The lid has separate corners, so that its edge is sharp in smooth shading too.
    return join(_band(lower, upper), fan(upper[1:], upper[0], closed=False))


def fan(rim: NDArray[np.float64], apex: Sequence[float] | NDArray[np.float64], *, closed: bool = True) -> Mesh:
    """Triangles from each edge of a rim (N, 3) to one corner; `closed` has the edge from its end to its begin."""
    count = len(rim)
    here = np.arange(count if closed else count - 1)
    faces = np.column_stack([here, (here + 1) % count, np.full(len(here), count)])
    return Mesh(np.vstack([rim, apex]).astype(np.float32), faces.astype(np.uint32))


def _band(one: NDArray[np.float64], other: NDArray[np.float64]) -> Mesh:
    """A strip between two closed lines (N, 3)."""
    here = np.arange(len(one))
    following = (here + 1) % len(one)
    lower = np.column_stack([here, following, following + len(one)])
    upper = np.column_stack([here, following + len(one), here + len(one)])
    return Mesh(np.concatenate([one, other]).astype(np.float32), np.concatenate([lower, upper]).astype(np.uint32))


def circle(radius_m: float, segments: int) -> NDArray[np.float64]:
    """Corners of a regular polygon (segments, 2), counter-clockwise, metres."""
    angles_rad = np.arange(segments) * (2 * math.pi / segments)
    return radius_m * np.column_stack([np.cos(angles_rad), np.sin(angles_rad)])


def robot_base() -> Mesh:
    """A flat disc that rims a `robot_body` seen from above."""
    return prism(circle(1.35, 24), 0.02, 0.1)


def robot_body() -> Mesh:
    """A round body of radius 1 and height 0.8, to be scaled by the robot's radius."""
    return prism(circle(1.0, 24), 0.1, 0.8)


def robot_nose() -> Mesh:
    """An arrow head on top of `robot_body`, pointing along x."""
    left = prism(np.array([[0.95, 0.0], [-0.3, 0.45], [-0.1, 0.0]]), 0.8, 0.9)
    right = prism(np.array([[0.95, 0.0], [-0.1, 0.0], [-0.3, -0.45]]), 0.8, 0.9)
    return join(left, right)


def hoop(inner: float, segments: int = 28) -> Mesh:
    """A flat ring of outer radius 1 and this inner radius."""
    outer = np.column_stack([circle(1.0, segments), np.zeros(segments)])
    return _band(outer, inner * outer)


def robot_dart() -> Mesh:
    """A body that points along x, of few triangles: half a disc behind, a tip ahead."""
    angles_rad = np.linspace(math.pi / 2, 3 * math.pi / 2, 7)
    behind = np.column_stack([np.cos(angles_rad), np.sin(angles_rad)])
    return prism(np.concatenate([[[1.7, 0.0]], behind]), 0.05, 0.8)


def cube() -> Mesh:
    """A unit cube about (0, 0, 0.5)."""
    return prism(np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]), 0.0, 1.0)


def pin(radius_m: float, height_m: float) -> Mesh:
    """A cone that stands on its tip: marks a place."""
    rim = np.column_stack([circle(radius_m, 10), np.full(10, height_m)])
    return join(fan(rim[::-1], (0.0, 0.0, 0.0)), fan(rim, (0.0, 0.0, height_m)))


def diamond(radius_m: float, height_m: float) -> Mesh:
    """An octahedron standing on a tip."""
    rim = np.column_stack([circle(radius_m, 4), np.full(4, height_m / 2)])
    return join(fan(rim[::-1], (0.0, 0.0, 0.0)), fan(rim, (0.0, 0.0, height_m)))


def flag() -> Mesh:
    """A pole with a triangle at its top, in the plane of x and z: marks a place that waits."""
    pole = prism(circle(0.025, 6), 0.0, 0.75)
    cloth = np.array([[0.02, 0.01, 0.75], [0.02, 0.01, 0.43], [0.38, 0.01, 0.59]])
    back = cloth * (1, -1, 1)
    vertices = np.concatenate([cloth, back]).astype(np.float32)
    return join(pole, Mesh(vertices, np.array([[0, 1, 2], [3, 5, 4]], np.uint32)))


def bolt() -> Mesh:
    """A flash that lies above the floor: marks a charger."""
    upper = np.array([[0.06, 0.24], [-0.16, -0.02], [0.06, -0.02]])
    lower = np.array([[-0.06, -0.24], [0.16, 0.02], [-0.06, 0.02]])
    return join(prism(upper, 0.03, 0.08), prism(lower, 0.03, 0.08))


def tent(radius_m: float, height_m: float) -> Mesh:
    """A pyramid on a square."""
    return fan(np.column_stack([circle(radius_m, 4), np.zeros(4)]), (0.0, 0.0, height_m))


def join(*meshes: Mesh) -> Mesh:
    """Several meshes as one."""
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + np.uint32(offset) for mesh, offset in zip(meshes, offsets, strict=True)]),
    )
