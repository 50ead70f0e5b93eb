"""Gauss–Newton steps for the pose of a scan: normal equations in x, y and yaw, and the directions that are held.

Kernels of other files call these. numba's cache does not notice an edit here, so edit those files too.
"""

import math

import numpy as np
from numba import njit

from robrain.algorithms.numeric.kernel_array import Floats

SWEEPS = 12
"""Limit; Jacobi's method needs four or five sweeps for a 3 × 3 matrix."""
NEGLIGIBLE = 1e-17


@njit(cache=True, nogil=True)
def eigen(matrix: Floats, values: Floats, vectors: Floats) -> None:
    """Write a symmetric matrix's eigenvalues (3,), ascending, and eigenvectors (3, 3), as columns; overwrites `matrix`.

    Jacobi's method, cyclic by rows (Golub and Van Loan, *Matrix Computations*, section 8.5), because LAPACK's results
    differ by processor; see `small_linear_algebra`. The sign of an eigenvector is arbitrary.
    """
    for i in range(3):
        for j in range(3):
            vectors[i, j] = 1.0 if i == j else 0.0
    for _sweep in range(SWEEPS):
        if matrix[0, 1] == 0.0 and matrix[0, 2] == 0.0 and matrix[1, 2] == 0.0:
            break
        for p in range(2):
            for q in range(p + 1, 3):
                aside = matrix[p, q]
                if abs(aside) <= NEGLIGIBLE * min(abs(matrix[p, p]), abs(matrix[q, q])):
                    matrix[p, q] = matrix[q, p] = 0.0
                    continue
                half = (matrix[q, q] - matrix[p, p]) / (2.0 * aside)
                tan = 1.0 / (abs(half) + math.sqrt(half * half + 1.0))
                if half < 0.0:
                    tan = -tan
                cos = 1.0 / math.sqrt(tan * tan + 1.0)
                sin = tan * cos
                matrix[p, p] -= tan * aside
                matrix[q, q] += tan * aside
                matrix[p, q] = matrix[q, p] = 0.0
                k = 3 - p - q
                by_p, by_q = matrix[k, p], matrix[k, q]
                matrix[k, p] = matrix[p, k] = cos * by_p - sin * by_q
                matrix[k, q] = matrix[q, k] = sin * by_p + cos * by_q
                for i in range(3):
                    by_p, by_q = vectors[i, p], vectors[i, q]
                    vectors[i, p] = cos * by_p - sin * by_q
                    vectors[i, q] = sin * by_p + cos * by_q
    for i in range(3):
        values[i] = matrix[i, i]
    for last in range(2, 0, -1):
        for k in range(last):
            if values[k] > values[k + 1]:
                values[k], values[k + 1] = values[k + 1], values[k]
                for i in range(3):
                    vectors[i, k], vectors[i, k + 1] = vectors[i, k + 1], vectors[i, k]


@njit(cache=True, nogil=True)
def lever_of(points: Floats, per_m: float) -> float:
    """Cells by which a turn of one radian moves the points, as a root mean square."""
    square = 0.0
    for k in range(points.shape[0]):
        square += points[k, 0] ** 2 + points[k, 1] ** 2
    return per_m * math.sqrt(square / points.shape[0])


@njit(cache=True, nogil=True)
def add_residual(
    information: Floats, pull: Floats, by_x: float, by_y: float, by_turn: float, residual: float, weight: float
) -> None:
    """Add a residual with these derivatives to the normal equations: upper triangle (3, 3) and right side (3,)."""
    information[0, 0] += weight * by_x * by_x
    information[0, 1] += weight * by_x * by_y
    information[0, 2] += weight * by_x * by_turn
    information[1, 1] += weight * by_y * by_y
    information[1, 2] += weight * by_y * by_turn
    information[2, 2] += weight * by_turn * by_turn
    pull[0] -= weight * residual * by_x
    pull[1] -= weight * residual * by_y
    pull[2] -= weight * residual * by_turn


@njit(cache=True, nogil=True)
def solve_step(
    information: Floats, pull: Floats, least: float, values: Floats, vectors: Floats, step: Floats
) -> tuple[int, float]:
    """Solve the normal equations for `step` (3,): how many directions are held, and the step's length.

    A direction is held if its information is at least `least`. A direction with less information here may have enough
    at the right place, so the step follows it too, but slowly. Writes eigenvalues and eigenvectors as `eigen` does;
    overwrites `information`.
    """
    information[1, 0], information[2, 0], information[2, 1] = information[0, 1], information[0, 2], information[1, 2]
    eigen(information, values, vectors)
    held = 0
    step[:] = 0.0
    for k in range(3):
        held += values[k] >= least
        along = 0.0
        for i in range(3):
            along += vectors[i, k] * pull[i]
        for i in range(3):
            step[i] += vectors[i, k] * along / max(values[k], least)
    return held, math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)


@njit(cache=True, nogil=True)
def held_directions(
    held: int, values: Floats, vectors: Floats, moved: tuple[float, float, float], lever: float, per_m: float
) -> Floats:
    """Held directions (3, 5) as row in m and rad, offset in m, information; `moved` is the way that the scan went."""
    found = np.zeros((3, 5))
    for at in range(held):
        k = 3 - held + at  # eigenvalues ascend
        found[at, 0], found[at, 1], found[at, 2] = vectors[0, k], vectors[1, k], vectors[2, k] * lever / per_m
        offset = vectors[0, k] * moved[0] + vectors[1, k] * moved[1] + vectors[2, k] * moved[2]
        found[at, 3], found[at, 4] = offset / per_m, values[k]
    return found
