"""Triangles of what stands on the floor: vertices float32 (V, 3) in metres, faces uint32 (F, 3)."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Mesh(NamedTuple):
    """A solid in its own frame, z up, standing on z = 0."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]


def prism(outline: NDArray[np.float64], z_min_m: float, z_max_m: float) -> Mesh:
    """A convex outline (N, 2), counter-clockwise, raised from `z_min_m` to `z_max_m`; its floor is left open."""
    count = len(outline)
    lower = np.column_stack([outline, np.full(count, z_min_m)])
    upper = np.column_stack([outline, np.full(count, z_max_m)])
    here = np.arange(count)
    following = (here + 1) % count
    sides = np.concatenate(
        [
            np.column_stack([here, following, following + count]),
            np.column_stack([here, following + count, here + count]),
        ]
    )
    lid = np.column_stack([np.zeros(count - 2, np.int64), here[1:-1], here[2:]]) + 2 * count
    # The lid has corners of its own, so that its edge is sharp in smooth shading too.
    vertices = np.concatenate([lower, upper, upper])
    return Mesh(vertices.astype(np.float32), np.concatenate([sides, lid]).astype(np.uint32))


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
    outline = np.array([[0.95, 0.0], [-0.3, 0.45], [-0.1, 0.0]])
    mirrored = outline[[0, 2]] * (1, -1)
    left = prism(outline, 0.8, 0.9)
    right = prism(np.array([mirrored[0], mirrored[1], [-0.3, -0.45]]), 0.8, 0.9)
    return join(left, right)


def hoop(inner: float, segments: int = 28) -> Mesh:
    """A flat ring of outer radius 1 and this inner radius."""
    outer = circle(1.0, segments)
    vertices = np.concatenate([outer, inner * outer])
    here = np.arange(segments)
    following = (here + 1) % segments
    faces = np.concatenate(
        [
            np.column_stack([here, following, here + segments]),
            np.column_stack([following, following + segments, here + segments]),
        ]
    )
    flat = np.column_stack([vertices, np.zeros(len(vertices))])
    return Mesh(flat.astype(np.float32), faces.astype(np.uint32))


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
    rim = circle(radius_m, 10)
    vertices = np.concatenate([np.column_stack([rim, np.full(10, height_m)]), [[0.0, 0.0, 0.0], [0.0, 0.0, height_m]]])
    here = np.arange(10)
    following = (here + 1) % 10
    tip, middle = np.full(10, 10), np.full(10, 11)
    faces = np.concatenate([np.column_stack([following, here, tip]), np.column_stack([here, following, middle])])
    return Mesh(vertices.astype(np.float32), faces.astype(np.uint32))


def diamond(radius_m: float, height_m: float) -> Mesh:
    """An octahedron standing on a tip."""
    rim = np.column_stack([circle(radius_m, 4), np.full(4, height_m / 2)])
    vertices = np.concatenate([rim, [[0.0, 0.0, 0.0], [0.0, 0.0, height_m]]])
    faces = [[(i + 1) % 4, i, 4] for i in range(4)] + [[i, (i + 1) % 4, 5] for i in range(4)]
    return Mesh(vertices.astype(np.float32), np.array(faces, np.uint32))


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
    vertices = np.concatenate([np.column_stack([circle(radius_m, 4), np.zeros(4)]), [[0.0, 0.0, height_m]]])
    faces = [[i, (i + 1) % 4, 4] for i in range(4)]
    return Mesh(vertices.astype(np.float32), np.array(faces, np.uint32))


def join(*meshes: Mesh) -> Mesh:
    """Several meshes as one."""
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + np.uint32(offset) for mesh, offset in zip(meshes, offsets, strict=True)]),
    )
