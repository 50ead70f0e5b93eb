"""A pose graph of submaps: their poses in the arena, from measured relative poses of pairs of them.

Graph SLAM as in Grisetti et al., *A tutorial on graph-based SLAM*, IEEE Intelligent Transportation Systems Magazine
2(4), 2010. The solver is Gauss–Newton on the residuals of the edges. Edges that may be false are weighed by dynamic
covariance scaling (Agarwal et al., *Robust map optimization using dynamic covariance scaling*, ICRA 2013). It is the
closed form of the switchable constraints of Sünderhauf and Protzel (IROS 2012).

Nodes are poses T_arena_node. An edge says that a pose fixed to one node and a pose fixed to another node are the same
pose in the arena. A node may be held fixed: the arena itself, or a submap of another robot, which only its owner moves.
The arithmetic is compiled without BLAS, so that results are equal on every processor.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.geometry import Pose2D, wrap_angle_rad

ITERATIONS_MAX = 10
DONE = 1e-6
"""The iteration ends after a step with no component larger than this, metres or radians."""
DETERMINED = 1e-13
"""Least ratio of a pivot of Cholesky's method to the diagonal element: a smaller pivot is rounding error."""
SCALING = 5.0
"""Φ of dynamic covariance scaling: edges with a larger squared residual lose weight. True edges have about 3."""


class Edge(NamedTuple):
    """A pose relative to node `one` and a pose relative to node `other` are the same pose in the arena.

    `information` (3, 3) is the inverse covariance of the difference other − one in x, y (m) and yaw (rad), in the axes
    of `at_one`.
    """

    one: int
    at_one: Pose2D
    other: int
    at_other: Pose2D
    information: Floats
    may_be_false: bool
    sure: Floats | None = None
    """(3, 3) information for the covariances; `information` if None. Errors that edges share do not average out."""
    gate: Floats | None = None
    """(3, 3) information of the residual that is expected before the graph is solved; `information` if None. Dynamic
    covariance scaling uses it to judge whether the edge is false."""


class Solution(NamedTuple):
    """Solution of a pose graph."""

    poses: list[Pose2D]
    """T_arena_node of each free node."""
    covariances: Floats
    """(n, 3, 3) marginal covariance of x, y, yaw of each free node, m², m·rad and rad², arena frame."""


def solve(free: list[Pose2D], held: list[Pose2D], edges: list[Edge]) -> Solution | None:
    """The most likely poses of the free nodes.

    Args:
        free: initial T_arena_node of the free nodes, which are nodes 0 to n − 1.
        held: T_arena_node of the nodes that are held fixed, which are nodes n and on.
        edges: measured relative poses of pairs of nodes.

    Returns:
        None if the edges do not determine all free nodes.

    """
    nodes = np.array([(pose.x_m, pose.y_m, pose.yaw_rad) for pose in (*free, *held)], np.float64)
    nodes = nodes.reshape(-1, 3)
    ends = np.array([(edge.one, edge.other) for edge in edges], np.int64).reshape(-1, 2)
    places = np.array(
        [
            (a.x_m, a.y_m, a.yaw_rad, b.x_m, b.y_m, b.yaw_rad)
            for a, b in ((edge.at_one, edge.at_other) for edge in edges)
        ],
        np.float64,
    ).reshape(-1, 6)
    information = np.array([edge.information for edge in edges], np.float64).reshape(-1, 3, 3)
    counted = [edge.information if edge.sure is None else edge.sure for edge in edges]
    sure = np.array(counted, np.float64).reshape(-1, 3, 3)
    judged = [edge.information if edge.gate is None else edge.gate for edge in edges]
    gate = np.array(judged, np.float64).reshape(-1, 3, 3)
    doubtful = np.array([edge.may_be_false for edge in edges], np.bool_)
    covariances = np.zeros((len(free), 3, 3))
    if not _solve(nodes, len(free), ends, places, information, sure, gate, doubtful, covariances):
        return None
    poses = [Pose2D(x_m, y_m, wrap_angle_rad(yaw_rad)) for x_m, y_m, yaw_rad in nodes[: len(free)].tolist()]
    return Solution(poses, covariances)


@njit(cache=True, nogil=True)
def _residual(nodes: Floats, one: int, other: int, place: Floats, residual: Floats, jacobian: Floats) -> None:
    """Write the residual (3,) of an edge, and its derivatives (2, 3, 3) with respect to the poses of both nodes.

    How the yaws differ does not depend on the places: those derivatives stay 0.
    """
    cos_one, sin_one = math.cos(nodes[one, 2]), math.sin(nodes[one, 2])
    cos_other, sin_other = math.cos(nodes[other, 2]), math.sin(nodes[other, 2])
    arm_one_x = cos_one * place[0] - sin_one * place[1]
    arm_one_y = sin_one * place[0] + cos_one * place[1]
    arm_other_x = cos_other * place[3] - sin_other * place[4]
    arm_other_y = sin_other * place[3] + cos_other * place[4]
    dx = nodes[other, 0] + arm_other_x - nodes[one, 0] - arm_one_x
    dy = nodes[other, 1] + arm_other_y - nodes[one, 1] - arm_one_y
    axis = nodes[one, 2] + place[2]
    cos, sin = math.cos(axis), math.sin(axis)
    residual[0] = cos * dx + sin * dy
    residual[1] = -sin * dx + cos * dy
    turn = nodes[other, 2] + place[5] - axis
    residual[2] = turn - 2.0 * math.pi * math.floor((turn + math.pi) / (2.0 * math.pi))
    # When a node turns, the place moves at right angles to its arm.
    jacobian[0, 0, 0], jacobian[0, 0, 1] = -cos, -sin
    jacobian[0, 1, 0], jacobian[0, 1, 1] = sin, -cos
    jacobian[0, 0, 2] = residual[1] - (cos * -arm_one_y + sin * arm_one_x)
    jacobian[0, 1, 2] = -residual[0] - (-sin * -arm_one_y + cos * arm_one_x)
    jacobian[0, 2, 2] = -1.0
    jacobian[1, 0, 0], jacobian[1, 0, 1] = cos, sin
    jacobian[1, 1, 0], jacobian[1, 1, 1] = -sin, cos
    jacobian[1, 0, 2] = cos * -arm_other_y + sin * arm_other_x
    jacobian[1, 1, 2] = -sin * -arm_other_y + cos * arm_other_x
    jacobian[1, 2, 2] = 1.0


@njit(cache=True, nogil=True)
def _factor(matrix: Floats) -> bool:
    """Write Cholesky's lower factor into a symmetric matrix; False if it is not positive definite."""
    size = matrix.shape[0]
    for i in range(size):
        for j in range(i + 1):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not rest > DETERMINED * matrix[i, i]:
                    return False
                matrix[i, i] = math.sqrt(rest)
            else:
                matrix[i, j] = rest / matrix[j, j]
    return True


@njit(cache=True, nogil=True)
def _substitute(lower: Floats, vector: Floats, first: int) -> None:
    """Solve L · Lᵀ · x = `vector` in place; its entries before `first` are 0."""
    size = vector.shape[0]
    for i in range(first, size):
        rest = vector[i]
        for k in range(first, i):
            rest -= lower[i, k] * vector[k]
        vector[i] = rest / lower[i, i]
    for i in range(size - 1, -1, -1):
        rest = vector[i]
        for k in range(i + 1, size):
            rest -= lower[k, i] * vector[k]
        vector[i] = rest / lower[i, i]


@njit(cache=True, nogil=True)
def _solve(
    nodes: Floats,
    free: int,
    ends: NDArray[np.int64],
    places: Floats,
    information: Floats,
    sure: Floats,
    gate: Floats,
    doubtful: NDArray[np.bool_],
    covariances: Floats,
) -> bool:
    size = 3 * free
    hessian = np.zeros((size, size))
    step = np.zeros(size)
    residual = np.zeros(3)
    jacobian = np.zeros((2, 3, 3))
    weighed = np.zeros((2, 3, 3))
    is_last = False
    iteration = 0
    while True:
        hessian[:] = 0.0
        step[:] = 0.0
        for e in range(ends.shape[0]):
            _residual(nodes, ends[e, 0], ends[e, 1], places[e], residual, jacobian)
            expected = 0.0
            for i in range(3):
                for j in range(3):
                    expected += residual[i] * gate[e, i, j] * residual[j]
            weight = 1.0
            if doubtful[e] and expected > SCALING:
                weight = (2.0 * SCALING / (SCALING + expected)) ** 2
            for side in range(2):
                for i in range(3):
                    for j in range(3):
                        total = 0.0
                        for k in range(3):
                            each = sure[e, k, j] if is_last else information[e, k, j]
                            total += jacobian[side, k, i] * each
                        weighed[side, i, j] = weight * total
            for side in range(2):
                if ends[e, side] >= free:
                    continue
                at = 3 * ends[e, side]
                for i in range(3):
                    for k in range(3):
                        step[at + i] -= weighed[side, i, k] * residual[k]
                for against in range(2):
                    if ends[e, against] >= free:
                        continue
                    to = 3 * ends[e, against]
                    for i in range(3):
                        for j in range(3):
                            total = 0.0
                            for k in range(3):
                                total += weighed[side, i, k] * jacobian[against, k, j]
                            hessian[at + i, to + j] += total
        if not _factor(hessian):
            return False
        if is_last:
            break
        _substitute(hessian, step, 0)
        largest = 0.0
        for i in range(size):
            largest = max(largest, abs(step[i]))
            nodes[i // 3, i % 3] += step[i]
        iteration += 1
        is_last = largest < DONE or iteration >= ITERATIONS_MAX
    column = np.zeros(size)
    for n in range(free):
        for j in range(3):
            column[:] = 0.0
            column[3 * n + j] = 1.0
            _substitute(hessian, column, 3 * n)
            for i in range(3):
                covariances[n, i, j] = column[3 * n + i]
    return True
